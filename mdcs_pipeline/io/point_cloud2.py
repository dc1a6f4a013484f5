"""The bytes of `sensor_msgs/PointCloud2`, both ways, without ROS.

A message is anything with the attributes of the ROS definition: of rclpy, of rosbags
(ROS 1 and 2), or a `PackedCloud`. Nothing is assumed about its layout but what its own
fields say. Source: sensor_msgs/msg/PointCloud2.msg and PointField.msg of ROS 2 Kilted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, SupportsInt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mdcs_pipeline.arrays import FloatArray, numeric_array, points_array
from mdcs_pipeline.errors import InputError, OutputError, suggestion

# PointField's constants INT8 to FLOAT64.
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_CODES = {np.dtype(name): code for code, name in _TYPES.items()}

NANO = 1_000_000_000
# builtin_interfaces/Time counts its seconds in an int32.
_LAST_SECOND = 2**31 - 1


class CloudLike(Protocol):
    """A `sensor_msgs/PointCloud2`, as far as its points go."""

    height: Any
    width: Any
    fields: Any
    is_bigendian: Any
    point_step: Any
    row_step: Any
    data: Any


class StampLike(Protocol):
    """A `builtin_interfaces/Time`, or a ROS 1 time as rosbags gives it."""

    sec: Any
    nanosec: Any


@dataclass(frozen=True)
class PackedField:
    """The values of a `sensor_msgs/PointField`."""

    name: str
    offset: int
    datatype: int
    count: int


class PackedCloud(NamedTuple):
    """The values of a `sensor_msgs/PointCloud2`, without its header.

    Attributes
    ----------
    height, width : int
        1 and the number of points.
    fields : tuple of PackedField
    is_bigendian : bool
        False.
    point_step, row_step : int
        Bytes of a point, and of all of them.
    data : (row_step,) uint8
    is_dense : bool
        Whether every coordinate is finite.
    """

    height: int
    width: int
    fields: tuple[PackedField, ...]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: NDArray[np.uint8]
    is_dense: bool


def decode_points(cloud: CloudLike, names: Sequence[str] = ("x", "y", "z")) -> FloatArray:
    """Return the coordinates of a cloud, whatever its layout and byte order.

    Parameters
    ----------
    cloud : PointCloud2
        Organised clouds are read row by row; padding behind points and rows is skipped.
        `is_dense` is not believed: NaN and infinity come through.
    names : sequence of str
        Fields that hold the coordinates.

    Returns
    -------
    (N, 3) float32 or float64
        An array of its own, in native byte order. float32 where every field is, and
        float64 otherwise.

    Raises
    ------
    InputError
        If a field is missing or does not fit into its point, or there are fewer bytes
        than the points need.
    """
    columns = [_column(cloud, name) for name in names]
    single = all(column.dtype.newbyteorder("=") == np.float32 for column in columns)
    points = np.empty((columns[0].size, len(columns)), np.float32 if single else np.float64)
    for place, column in zip(points.T, columns, strict=True):
        place.reshape(column.shape)[...] = column
    return points


def decode_field(cloud: CloudLike, name: str) -> NDArray[Any]:
    """Return one field of every point, such as ``intensity``.

    Parameters
    ----------
    cloud : PointCloud2
    name : str

    Returns
    -------
    (N,) array
        Of the field's own type in native byte order; an array of its own.

    Raises
    ------
    InputError
        As in `decode_points`.
    """
    column = _column(cloud, name)
    return np.array(column, column.dtype.newbyteorder("="), order="C").reshape(-1)


def encode_points(
    points: ArrayLike, columns: Mapping[str, ArrayLike] | None = None, *, double: bool = False
) -> PackedCloud:
    """Pack points, and a value or several of each, as `sensor_msgs/PointCloud2` has them.

    Parameters
    ----------
    points : (N, 3) array-like
        NaN may be among them and clears `is_dense`.
    columns : mapping of str to (N,) array-like, optional
        Further fields by name, each in the narrowest of PointField's types that holds it:
        its own, or uint8 for truth values.
    double : bool
        Coordinates as float64. rviz reads float32 alone, whose 24 bits are 1 cm at
        100 km from the origin.

    Returns
    -------
    PackedCloud
        In one row without padding, little-endian.

    Raises
    ------
    InputError
        If the arrays do not fit together.
    OutputError
        If there is no type in the format for a column, or a coordinate is beyond float32.
    """
    held = points_array(points)
    with np.errstate(over="ignore"):
        packed = held.astype("<f8" if double else "<f4")
    if np.isfinite(held).sum() != np.isfinite(packed).sum():
        raise OutputError(
            "a coordinate is beyond the range of float32",
            received=f"{np.nanmax(np.abs(held[np.isfinite(held)]))}",
            remedy="move the origin near the points, or pack with double=True",
        )
    parts: list[tuple[str, NDArray[Any]]] = [
        *zip("xyz", packed.T, strict=True),
        *(_extra(name, value, len(held)) for name, value in (columns or {}).items()),
    ]
    layout = np.dtype([(name, column.dtype) for name, column in parts])
    rows = np.empty(len(held), layout)
    for name, column in parts:
        rows[name] = column
    offsets = np.cumsum([0, *(column.itemsize for _, column in parts)]).tolist()
    fields = tuple(
        PackedField(name, offset, _CODES[column.dtype.newbyteorder("=")], 1)
        for (name, column), offset in zip(parts, offsets, strict=False)
    )
    data = rows.view(np.uint8) if len(rows) else np.empty(0, np.uint8)
    dense = bool(np.isfinite(held).all())
    return PackedCloud(
        1, len(held), fields, False, layout.itemsize, layout.itemsize * len(held), data, dense
    )


def stamp_to_ns(stamp: StampLike) -> int:
    """Return a ROS time as nanoseconds.

    Raises `InputError` if it lies before 1970.
    """
    total = int(stamp.sec) * NANO + int(stamp.nanosec)
    if total < 0:
        raise InputError("the stamp is negative", received=f"{stamp.sec} s, {stamp.nanosec} ns")
    return total


def ns_to_stamp(stamp_ns: SupportsInt) -> tuple[int, int]:
    """Return nanoseconds as the seconds and nanoseconds of a ROS time.

    Raises `OutputError` if a ROS time cannot hold it: negative, or in 2038 and later.
    """
    seconds, rest = divmod(int(stamp_ns), NANO)
    if not 0 <= seconds <= _LAST_SECOND:
        raise OutputError(
            "a ROS time holds 0 to 2147483647 seconds",
            received=f"{seconds} s",
            remedy="give the stamp in nanoseconds since 1970",
        )
    return seconds, rest


def _extra(name: str, value: ArrayLike, count: int) -> tuple[str, NDArray[Any]]:
    column = numeric_array(value, f"column '{name}'")
    if column.shape != (count,):
        raise InputError(
            f"column '{name}' must have the shape ({count},)", received=f"shape {column.shape}"
        )
    if name in ("x", "y", "z") or not name:
        raise InputError(f"a column cannot be called '{name}'", remedy="choose another name")
    if column.dtype == np.bool_:
        column = column.astype(np.uint8)
    if column.dtype.newbyteorder("=") not in _CODES:
        raise OutputError(
            f"PointCloud2 has no type for the column '{name}'",
            received=str(column.dtype),
            remedy="convert it to int32, uint32, float32 or float64",
        )
    return name, column.astype(column.dtype.newbyteorder("<"))


def _column(cloud: CloudLike, name: str) -> NDArray[Any]:
    """Return a (height, width) view of one field in the message's own bytes."""
    field = _find(cloud, name)
    dtype = _type(cloud, field)
    height, width = int(cloud.height), int(cloud.width)
    step, row = int(cloud.point_step), int(cloud.row_step)
    offset = int(field.offset)
    if not height * width:
        return np.empty((height, width), dtype)
    if offset < 0 or offset + dtype.itemsize > step:
        raise _wrong(
            f"the field '{name}' does not fit into its point",
            f"{dtype.itemsize} bytes from {offset}, in a point of {step}",
        )
    if height == 1:
        # Some publishers leave it 0 where there is no second row.
        row = width * step
    if row < width * step:
        raise _wrong(
            "the rows of the cloud overlap", f"row_step {row}, {width} points of {step} bytes"
        )
    # array.array of rclpy, numpy of rosbags, bytes of others.
    data = np.frombuffer(cloud.data, np.uint8) if len(cloud.data) else np.empty(0, np.uint8)
    needed = (height - 1) * row + width * step
    if data.nbytes < needed:
        raise InputError(
            "the cloud has fewer bytes than its points need",
            received=f"{data.nbytes} bytes, {height} x {width} points need {needed}",
            remedy="the message was cut off, or its width and height are wrong",
        )
    return np.ndarray((height, width), dtype, data, offset, (row, step))


def _wrong(what: str, received: str) -> InputError:
    return InputError(what, received=received, remedy="the publisher lays its points out wrongly")


def _find(cloud: CloudLike, name: str) -> Any:
    names = [str(field.name) for field in cloud.fields]
    if name not in names:
        what, held = f"the cloud has no field '{name}'", ", ".join(names) or "no fields"
        raise InputError(what, received=held, remedy=suggestion(name, names))
    return cloud.fields[names.index(name)]


def _type(cloud: CloudLike, field: Any) -> np.dtype[Any]:
    code = _TYPES.get(int(field.datatype))
    if code is None:
        raise InputError(
            f"the field '{field.name}' has an unknown type",
            received=f"datatype {field.datatype}",
            remedy="PointField knows 1 to 8",
        )
    # Old publishers write 0 for a single value.
    if int(field.count) > 1:
        raise InputError(
            f"the field '{field.name}' holds several values a point",
            received=f"count {field.count}",
            remedy="a field of one value was wanted",
        )
    return np.dtype((">" if cloud.is_bigendian else "<") + code)
