"""Checks of PLY files, before Open3D is given them.

Open3D 0.20 gives back as many points as the header declares, filled with unset memory
where the file ends early. Format: G. Turk, The PLY Polygon File Format, 1994.
"""

from __future__ import annotations

import math
import mmap
import struct
from array import array
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.errors import InputError
from mdcs_pipeline.io.rows import Checked, bad_line, check_end, check_row, is_count, quote

_TYPES = {
    **dict.fromkeys(("char", "int8"), "b"),
    **dict.fromkeys(("uchar", "uint8"), "B"),
    **dict.fromkeys(("short", "int16"), "h"),
    **dict.fromkeys(("ushort", "uint16"), "H"),
    **dict.fromkeys(("int", "int32"), "i"),
    **dict.fromkeys(("uint", "uint32"), "I"),
    **dict.fromkeys(("float", "float32"), "f"),
    **dict.fromkeys(("double", "float64"), "d"),
}
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
# With a part of these, Open3D stops inside the file and gives unset memory for the rest.
_TOGETHER = (("nx", "ny", "nz"), ("red", "green", "blue"))


class Property(NamedTuple):
    """One property; `length` is the type of a list's length, empty for a single value."""

    name: str
    code: str
    length: str = ""


class Element(NamedTuple):
    """One element: its rows and what each of them holds."""

    name: str
    rows: int
    properties: list[Property]

    @property
    def has_lists(self) -> bool:
        """Whether rows may differ in length."""
        return any(item.length for item in self.properties)


class PlyHeader(NamedTuple):
    """What a PLY file declares; `order` is the byte order, empty for text."""

    order: str
    elements: list[Element]
    lines: int


def check_ply(path: Path) -> Checked:
    """Return the vertices of a PLY file whose contents fit its header.

    Raises
    ------
    InputError
        If the header is damaged, names no x, y and z, or declares other contents than
        the file has.
    """
    with path.open("rb") as stream:
        header = _read_header(path, stream)
        vertex = _vertices(path, header)
        if not header.order:
            return Checked(vertex.rows, _check_text(path, stream, header))
        start = stream.tell()
        _check_binary(path, stream, header)
        if header.elements[0] is not vertex or vertex.has_lists:
            return Checked(vertex.rows)
        return Checked(vertex.rows, _plain_rows(stream, header.order, vertex, start), sure=True)


def _plain_rows(stream: BinaryIO, order: str, vertex: Element, start: int) -> NDArray[np.float64]:
    """Return x, y and z of rows of one length, which need no parser and no Open3D."""
    kinds = [(f"{k} {item.name}", order + item.code) for k, item in enumerate(vertex.properties)]
    names = [item.name for item in vertex.properties]
    stream.seek(start)
    rows = np.fromfile(stream, np.dtype(kinds), vertex.rows)
    coordinates = np.empty((len(rows), 3))
    for axis, name in enumerate("xyz"):
        coordinates[:, axis] = rows[kinds[names.index(name)][0]]
    return coordinates


def _read_header(path: Path, stream: BinaryIO) -> PlyHeader:
    order: str | None = None
    elements: list[Element] = []
    if stream.readline(8).strip() != b"ply":
        raise bad_line(path, 1, "a PLY file starts with a line 'ply'", remedy="what is it really?")
    number = 1
    while True:
        line = stream.readline(65536)
        number += 1
        words = line.decode("latin-1").split()
        if not line:
            raise bad_line(path, number, "the PLY header has no line end_header")
        match words:
            case ["end_header"]:
                break
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", name, _] if name in _FORMATS:
                order = _FORMATS[name]
            case ["element", name, count] if is_count(count):
                elements.append(Element(name, int(count), []))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append(Property(name, _TYPES[kind]))
            case ["property", "list", length, kind, name] if (
                elements and kind in _TYPES and _TYPES.get(length, "d") not in "fd"
            ):
                elements[-1].properties.append(Property(name, _TYPES[kind], _TYPES[length]))
            case _:
                raise bad_line(path, number, "no line of a PLY header", line)
    if order is None:
        raise bad_line(path, number, "the PLY header has no line 'format'")
    return PlyHeader(order, elements, number)


def _vertices(path: Path, header: PlyHeader) -> Element:
    found = [element for element in header.elements if element.name == "vertex"]
    if len(found) != 1:
        raise InputError(
            "the PLY file must have one element 'vertex'",
            where=str(path),
            received=", ".join(element.name for element in header.elements) or "no element",
        )
    single = [item.name for item in found[0].properties if not item.length]
    missing = [name for name in "xyz" if single.count(name) != 1]
    if missing:
        raise InputError(
            f"the vertices need one property each of x, y, z; {', '.join(missing)} is not so",
            where=str(path),
            received=" ".join(single),
            remedy="a cloud has three coordinates a point",
        )
    for group in _TOGETHER:
        if sum(item.name in group for item in found[0].properties) > 0 and not (
            all(single.count(name) == 1 for name in group)
        ):
            raise InputError(
                f"the vertices have some of {', '.join(group)}, but not each of them once",
                where=str(path),
                received=" ".join(item.name for item in found[0].properties),
                remedy="export all three of them, or none",
            )
    return found[0]


def _ends_early(path: Path, element: Element, rows: int) -> InputError:
    return InputError(
        f"the header declares {element.rows} rows of '{element.name}', the file ends after {rows}",
        where=str(path),
        remedy="the file is cut off: copy or export it again",
    )


def _columns(element: Element) -> list[int]:
    """Return the text columns that must hold numbers: those in front of any list."""
    columns: list[int] = []
    for column, item in enumerate(element.properties):
        if item.length:
            return columns or [0]
        columns.append(column)
    return columns


def _check_text(path: Path, stream: BinaryIO, header: PlyHeader) -> NDArray[np.float64] | None:
    """Check every row; return the vertices, or None if a list stands before x, y or z."""
    number = header.lines
    found: array[float] = array("d")
    for element in header.elements:
        columns = _columns(element)
        names = [item.name for item in element.properties]
        places = [names.index(name) for name in "xyz"] if element.name == "vertex" else []
        for row in range(element.rows if columns else 0):
            line = b"\n"
            while line and not line.strip():
                line = stream.readline()
                number += 1
            if not line:
                raise _ends_early(path, element, row)
            fields, values = check_row(path, number, line, columns)
            if not element.has_lists and fields != len(columns):
                what = f"{fields} columns where the header declares {len(columns)}"
                raise bad_line(path, number, what, line)
            if any(map(math.isinf, values)):
                # Open3D stops there and leaves the rest of the points unset.
                what = "infinity, which Open3D does not read from a text PLY"
                raise bad_line(path, number, what, line, "write nan, or a binary PLY")
            found.extend(values[place] for place in places if place < len(values))
    check_end(path, stream, number, sum(element.rows for element in header.elements))
    (rows,) = (element.rows for element in header.elements if element.name == "vertex")
    return np.array(found).reshape(-1, 3) if len(found) == 3 * rows else None


def _check_binary(path: Path, stream: BinaryIO, header: PlyHeader) -> None:
    position = stream.tell()
    end = path.stat().st_size
    for element in header.elements:
        if element.has_lists:
            position = _walk(path, stream, header.order, element, position)
            continue
        row = struct.calcsize(header.order + "".join(item.code for item in element.properties))
        if position + element.rows * row > end:
            raise _ends_early(path, element, (end - position) // row)
        position += element.rows * row
    stream.seek(position)
    extra = stream.read(64).strip()
    if extra:
        raise InputError(
            "more data follow than the PLY header declares",
            where=str(path),
            received=f"{end - position} bytes more, {quote(extra[:16])}",
            remedy="set the counts in the header right",
        )


def _walk(path: Path, stream: BinaryIO, order: str, element: Element, position: int) -> int:
    """Return the place behind an element with lists, whose rows must be read one by one."""
    steps = [
        (struct.Struct(order + item.length) if item.length else None, struct.calcsize(item.code))
        for item in element.properties
    ]
    with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        for row in range(element.rows):
            for length, size in steps:
                if length is None:
                    position += size
                elif position + length.size > len(data):
                    raise _ends_early(path, element, row)
                else:
                    position += length.size + size * max(0, length.unpack_from(data, position)[0])
            if position > len(data):
                raise _ends_early(path, element, row)
    return position
