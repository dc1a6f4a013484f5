"""Checks of text rows that hold one point each.

Open3D skips rows that it cannot parse, or fills them with whatever the memory held;
so every row is looked at before Open3D is given the file.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.errors import InputError

# Column counts of PTS that Open3D knows: x y z, then intensity, then red green blue.
PTS_COLUMNS = (3, 4, 6, 7)


class Checked(NamedTuple):
    """What a file holds by its own account.

    Parameters
    ----------
    points : int
        How many.
    coordinates : (points, 3) float64, optional
        As the file's rows give them; None for binary files but the plainest.
    sure : bool
        Whether they need not be read again by Open3D.
    """

    points: int
    coordinates: NDArray[np.float64] | None = None
    sure: bool = False


def quote(line: bytes) -> str:
    """Return a line of a file as text that can be printed."""
    return line[:120].rstrip(b"\r\n").decode("ascii", "backslashreplace")


def bad_line(
    path: Path, number: int, what: str, line: bytes = b"", remedy: str | None = None
) -> InputError:
    """Return the error for one line of a file; lines count from 1."""
    return InputError(
        what, where=f"{path}, line {number}", received=quote(line) or None, remedy=remedy
    )


def is_count(word: str) -> bool:
    """Return whether a word of a header is a number of things, small enough for a file."""
    return word.isdecimal() and word.isascii() and len(word) < 19


def check_row(
    path: Path, number: int, line: bytes, columns: Sequence[int]
) -> tuple[int, list[float]]:
    """Return how many fields a row has, and the numbers in `columns` of it.

    Parameters
    ----------
    path : Path
        Named in the error.
    number : int
        Number of the line, from 1.
    line : bytes
    columns : sequence of int
        Columns that must hold a number (NaN and infinity are numbers).

    Raises
    ------
    InputError
        If a column is missing or holds no number.
    """
    fields = line.split()
    if b"\r" in line.rstrip(b"\r\n"):
        what = "a carriage return within a line"
        raise bad_line(path, number, what, line, "end the lines by newlines")
    if len(fields) <= max(columns):
        separated = b"," in line or b";" in line
        raise bad_line(
            path,
            number,
            f"{len(fields)} columns in a row that needs {max(columns) + 1}",
            line,
            "separate the columns by spaces, not by commas or semicolons"
            if separated
            else "every row needs x, y and z; the row is cut off, or the cloud has no z",
        )
    values = []
    for column in columns:
        field = fields[column]
        try:
            # Python takes 1_000 for a number, no writer of clouds does.
            values.append(float(field.replace(b"_", b"?")))
        except ValueError as error:
            raise bad_line(
                path,
                number,
                f"column {column + 1} is not a number",
                line,
                "mend or remove the row; a heading must start with #",
            ) from error
    return len(fields), values


def check_xyz(path: Path, needed: int) -> Checked:
    """Return what is in the rows of an XYZ or XYZN file.

    Empty rows and rows that start with ``#`` are skipped, as Open3D does.

    Parameters
    ----------
    path : Path
    needed : int
        Columns that must be numbers: 3, or 6 with normals.
    """
    found = array("d")
    width = 0
    with path.open("rb") as stream:
        for number, line in enumerate(stream, 1):
            text = line.strip()
            if not text or text.startswith(b"#"):
                continue
            fields, values = check_row(path, number, line, range(needed))
            if found and fields != width:
                what = f"{fields} columns after rows of {width}"
                raise bad_line(path, number, what, line, "is the file cut off or two joined?")
            width = fields
            found.extend(values[:3])
    return _checked(found)


def _checked(found: array[float]) -> Checked:
    coordinates = np.array(found).reshape(-1, 3)
    return Checked(len(coordinates), coordinates)


def check_pts(path: Path) -> Checked:
    """Return what is in the rows of a PTS file.

    The first line names the count; Open3D believes it, whatever follows.
    """
    with path.open("rb") as stream:
        first = stream.readline()
        if not is_count(first.strip().decode("latin-1")):
            raise bad_line(
                path,
                1,
                "a PTS file starts with its number of points",
                first,
                "put the count on a line of its own in front, or name the file .xyz",
            )
        declared = int(first)
        width, checked = check_table(path, stream, 1, declared, range(3))
    if declared and width not in PTS_COLUMNS:
        raise InputError(
            f"rows of {width} columns",
            where=str(path),
            remedy="PTS has x y z, then optionally intensity, then optionally r g b",
        )
    return checked


def check_table(
    path: Path, stream: BinaryIO, number: int, declared: int, columns: Sequence[int]
) -> tuple[int, Checked]:
    """Check that exactly `declared` rows of equal width follow; return width and rows.

    Parameters
    ----------
    path : Path
    stream : binary file
        At the first row.
    number : int
        Number of the line before it.
    declared : int
        Rows that the header promises.
    columns : sequence of int
        Columns of x, y and z.
    """
    width = 0
    found = array("d")
    for row in range(declared):
        number += 1
        line = stream.readline()
        if not line:
            raise InputError(
                f"the header declares {declared} points, the file ends after {row}",
                where=str(path),
                remedy="the file is cut off: copy or export it again",
            )
        fields, values = check_row(path, number, line, columns)
        if row and fields != width:
            raise bad_line(path, number, f"{fields} columns after rows of {width}", line)
        width = fields
        found.extend(values)
    check_end(path, stream, number, declared)
    return width, _checked(found)


def check_end(path: Path, stream: BinaryIO, number: int, declared: int) -> None:
    """Refuse anything but empty lines after the last declared row."""
    for line in stream:
        number += 1
        if line.strip():
            raise bad_line(
                path,
                number,
                f"the header declares {declared} points, but more rows follow",
                line,
                "set the count in the header right, or remove the rows",
            )
