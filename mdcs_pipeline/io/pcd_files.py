"""Checks of PCD files, before Open3D is given them.

Open3D 0.20 fills the cloud with unset memory when a PCD file is shorter than its
header says, and crashes on a file with some but not all of its normals.
Format: https://pointclouds.org/documentation/tutorials/pcd_file_format.html
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mdcs_pipeline.errors import InputError
from mdcs_pipeline.io.rows import Checked, check_table, is_count, quote

_KEYS = frozenset(
    ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
)
_TYPES = frozenset((*((kind, size) for kind in "IU" for size in (1, 2, 4, 8)), ("F", 4), ("F", 8)))
_NORMALS = frozenset(("normal_x", "normal_y", "normal_z"))


class PcdHeader(NamedTuple):
    """What a PCD file declares."""

    points: int
    fields: tuple[str, ...]
    types: tuple[tuple[str, int], ...]
    counts: tuple[int, ...]
    data: str
    lines: int

    @property
    def stride(self) -> int:
        """Bytes a point."""
        sizes = (size for _, size in self.types)
        return sum(size * count for size, count in zip(sizes, self.counts, strict=True))

    def columns(self) -> tuple[int, int, int]:
        """Return the text columns of x, y and z."""
        x, y, z = (sum(self.counts[: self.fields.index(name)]) for name in "xyz")
        return x, y, z


def check_pcd(path: Path) -> Checked:
    """Return the points of a PCD file whose contents fit its header.

    Raises
    ------
    InputError
        If the header is damaged, names no x, y and z, or declares other contents than
        the file has.
    """
    with path.open("rb") as stream:
        header = _read_header(path, stream)
        if header.data == "ascii":
            return check_table(path, stream, header.lines, header.points, header.columns())[1]
        if header.data == "binary":
            _check_binary(path, stream, header)
        else:
            _check_compressed(path, stream, header)
    return Checked(header.points)


def _damaged(path: Path, what: str, received: object = None) -> InputError:
    return InputError(
        what,
        where=str(path),
        received=received,
        remedy="the file is cut off, damaged or no PCD file: export it again",
    )


def _read_lines(path: Path, stream: BinaryIO) -> tuple[dict[str, list[str]], int]:
    entries: dict[str, list[str]] = {}
    lines = 0
    while "DATA" not in entries:
        line = stream.readline(65536)
        lines += 1
        words = line.decode("latin-1").split()
        if not line:
            raise _damaged(path, "the PCD header has no line DATA")
        if not words or words[0].startswith("#"):
            continue
        if words[0] not in _KEYS:
            raise _damaged(path, f"line {lines} is no line of a PCD header", quote(line))
        entries[words[0]] = words[1:]
    return entries, lines


def _numbers(path: Path, entries: dict[str, list[str]], key: str) -> tuple[int, ...]:
    words = entries[key]
    if not words or not all(map(is_count, words)):
        raise _damaged(path, f"{key} must hold whole numbers", " ".join(words))
    return tuple(int(word) for word in words)


def _read_header(path: Path, stream: BinaryIO) -> PcdHeader:
    entries, lines = _read_lines(path, stream)
    fields = tuple(entries.get("FIELDS", ()))
    entries.setdefault("COUNT", ["1"] * len(fields))
    for key in ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT"):
        if key not in entries:
            raise _damaged(path, f"the PCD header has no line {key}")
    entries.setdefault("POINTS", _product(path, entries))
    sizes, counts = _numbers(path, entries, "SIZE"), _numbers(path, entries, "COUNT")
    if not len(fields) == len(sizes) == len(counts) == len(entries["TYPE"]):
        raise _damaged(path, "FIELDS, SIZE, TYPE and COUNT differ in length")
    header = PcdHeader(
        points=_numbers(path, entries, "POINTS")[0],
        fields=fields,
        types=tuple(zip(entries["TYPE"], sizes, strict=True)),
        counts=counts,
        data=" ".join(entries["DATA"]),
        lines=lines,
    )
    if _product(path, entries) != [str(header.points)]:
        raise _damaged(path, "WIDTH times HEIGHT differs from POINTS", header.points)
    _check_fields(path, header)
    return header


def _product(path: Path, entries: dict[str, list[str]]) -> list[str]:
    return [str(_numbers(path, entries, "WIDTH")[0] * _numbers(path, entries, "HEIGHT")[0])]


def _check_fields(path: Path, header: PcdHeader) -> None:
    if header.data not in ("ascii", "binary", "binary_compressed"):
        raise _damaged(path, "DATA must be ascii, binary or binary_compressed", header.data)
    if not set(header.types) <= _TYPES:
        raise _damaged(path, "TYPE and SIZE name a type that PCD does not have", header.types)
    missing = [name for name in "xyz" if header.fields.count(name) != 1]
    if missing:
        raise InputError(
            f"the PCD file needs one field each of x, y, z; {', '.join(missing)} is not so",
            where=str(path),
            received=" ".join(header.fields),
        )
    places = [header.fields.index(name) for name in "xyz"]
    if len({(header.types[i], header.counts[i]) for i in places}) > 1:
        raise InputError(
            "x, y and z must be of one type",
            where=str(path),
            received=", ".join("{}{}".format(*header.types[i]) for i in places),
            remedy="export the file with x, y and z all float (F 4) or all double (F 8)",
        )
    if 0 < len(_NORMALS & set(header.fields)) < 3:
        raise InputError(
            "the PCD file has some fields of a normal, but not all three",
            where=str(path),
            received=" ".join(header.fields),
            remedy="export normal_x, normal_y and normal_z, or none of them",
        )


def _remaining(path: Path, stream: BinaryIO) -> int:
    return path.stat().st_size - stream.tell()


def _check_binary(path: Path, stream: BinaryIO, header: PcdHeader) -> None:
    have = _remaining(path, stream)
    need = header.points * header.stride
    if have < need or have >= need + header.stride:
        raise _damaged(
            path,
            f"the header declares {header.points} points of {header.stride} bytes, "
            f"the file holds {have // header.stride}",
            f"{have} bytes of data where {need} are declared",
        )


def _check_compressed(path: Path, stream: BinaryIO, header: PcdHeader) -> None:
    sizes = stream.read(8)
    if len(sizes) < 8:
        raise _damaged(path, f"the header declares {header.points} points, no data follow")
    packed, unpacked = struct.unpack("<II", sizes)
    have = _remaining(path, stream)
    if have < packed:
        raise _damaged(path, f"{packed} bytes of compressed data declared, the file holds {have}")
    if unpacked != header.points * header.stride:
        raise _damaged(
            path,
            f"the header declares {header.points} points of {header.stride} bytes, "
            f"the compressed data hold {unpacked} bytes",
        )
