"""PointCloud2 bytes: any layout in, one layout out."""

from __future__ import annotations

import array
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mdcs_pipeline.errors import InputError, OutputError
from mdcs_pipeline.io.point_cloud2 import (
    PackedField,
    decode_field,
    decode_points,
    encode_points,
    ns_to_stamp,
    stamp_to_ns,
)

POINTS = np.array([[1.5, -2.25, 3.0], [np.nan, 0.0, np.inf], [1e-3, 7.0, -1e6]], np.float32)
CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


@dataclass
class Message:
    """What a driver publishes, laid out byte by byte."""

    height: int
    width: int
    fields: list[PackedField]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: Any
    is_dense: bool = field(default=True)


def laid_out(
    points: np.ndarray,
    kinds: str = "f4 f4 f4",
    offsets: tuple[int, ...] = (0, 4, 8),
    step: int = 12,
    big: bool = False,
    height: int = 1,
    pad: int = 0,
) -> Message:
    """Write every value by struct's rules, apart from the code under test."""
    import struct

    letters = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I"}
    letters |= {"f4": "f", "f8": "d"}
    width = len(points) // height
    row = width * step + pad
    data = bytearray(b"\xcd" * (row * height))
    for k, point in enumerate(points.tolist()):
        start = (k // width) * row + (k % width) * step
        for value, kind, offset in zip(point, kinds.split(), offsets, strict=True):
            text = (">" if big else "<") + letters[kind]
            struct.pack_into(text, data, start + offset, value if "f" in kind else int(value))
    fields = [
        PackedField(name, offset, CODES[kind], 1)
        for name, offset, kind in zip("xyz", offsets, kinds.split(), strict=True)
    ]
    return Message(height, width, fields, big, step, row, bytes(data))


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(
    ("kinds", "offsets", "step", "kind"),
    [
        ("f4 f4 f4", (0, 4, 8), 12, np.float32),
        ("f4 f4 f4", (0, 4, 8), 32, np.float32),
        ("f4 f4 f4", (9, 1, 5), 13, np.float32),
        ("f8 f8 f8", (3, 12, 20), 30, np.float64),
        ("f4 f8 f4", (0, 4, 12), 16, np.float64),
    ],
)
def test_layouts(kinds: str, offsets: tuple[int, ...], step: int, kind: type, big: bool) -> None:
    """Offsets, padding, unaligned fields, mixed types and both byte orders."""
    got = decode_points(laid_out(POINTS, kinds, offsets, step, big))
    assert got.dtype == kind
    assert got.dtype.isnative
    np.testing.assert_array_equal(got, POINTS)


@pytest.mark.parametrize("kind", ["i1", "u1", "i2", "u2", "i4", "u4"])
def test_integer_coordinates(kind: str) -> None:
    """Integer coordinates come as float64, which holds every one of them."""
    top = np.iinfo(kind).max
    points = np.array([[1, 2, 3], [top, 0, top - 1]], np.float64)
    size = np.dtype(kind).itemsize
    got = decode_points(laid_out(points, f"{kind} " * 3, (0, size, 2 * size), 3 * size))
    assert got.dtype == np.float64
    np.testing.assert_array_equal(got, points)


def test_organised_cloud_skips_row_padding() -> None:
    """Rows come one after the other, without what lies between them."""
    points = np.arange(36, dtype=np.float32).reshape(12, 3)
    np.testing.assert_array_equal(decode_points(laid_out(points, height=3, pad=7)), points)


def test_last_row_may_lack_its_padding() -> None:
    """Some drivers end the data with the last point."""
    points = np.arange(36, dtype=np.float32).reshape(12, 3)
    message = laid_out(points, height=3, pad=7)
    message.data = message.data[:-7]
    np.testing.assert_array_equal(decode_points(message), points)


@pytest.mark.parametrize("holder", [bytes, bytearray, lambda b: array.array("B", b)])
def test_data_holders(holder: Any) -> None:
    """bytes, bytearray, and the array.array of rclpy."""
    message = laid_out(POINTS)
    message.data = holder(message.data)
    np.testing.assert_array_equal(decode_points(message), POINTS)


def test_result_is_apart_from_the_message() -> None:
    """A message whose buffer is used again must not change points already taken."""
    message = laid_out(POINTS[[0, 2]])
    message.data = bytearray(message.data)
    got = decode_points(message)
    one = decode_field(message, "x")
    message.data[:] = bytes(len(message.data))
    np.testing.assert_array_equal(got, POINTS[[0, 2]])
    np.testing.assert_array_equal(one, POINTS[[0, 2], 0])


def test_single_row_needs_no_row_step() -> None:
    """row_step 0 with one row is common and means nothing."""
    message = laid_out(POINTS)
    message.row_step = 0
    np.testing.assert_array_equal(decode_points(message), POINTS)


def test_empty_cloud() -> None:
    """No points, no bytes, no steps: an empty array, not an error."""
    message = laid_out(POINTS[:0])
    message.point_step = 0
    assert decode_points(message).shape == (0, 3)
    assert decode_points(encode_points(POINTS[:0])).shape == (0, 3)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"fields": []}, "no field 'x'"),
        ({"fields": [PackedField("X", 0, 7, 1)]}, "no field 'x'"),
        ({"fields": [PackedField(c, 0, 9, 1) for c in "xyz"]}, "unknown type"),
        ({"fields": [PackedField(c, 0, 7, 3) for c in "xyz"]}, "several values"),
        ({"fields": [PackedField(c, 9, 7, 1) for c in "xyz"]}, "does not fit"),
        ({"point_step": 0}, "does not fit"),
        ({"data": b"\0" * 35}, "fewer bytes"),
        ({"data": b""}, "fewer bytes"),
        ({"width": 4}, "fewer bytes"),
        ({"height": 3, "width": 1, "row_step": 11}, "overlap"),
    ],
)
def test_refusals(change: dict[str, Any], text: str) -> None:
    """Every wrong message is refused in words, none read past its end."""
    message = laid_out(POINTS)
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(InputError, match=text):
        decode_points(message)


def test_old_count_of_zero() -> None:
    """Old publishers write count 0 for one value."""
    message = laid_out(POINTS)
    message.fields = [replace(f, count=0) for f in message.fields]
    np.testing.assert_array_equal(decode_points(message), POINTS)


@given(
    hnp.arrays(
        st.sampled_from([np.float32, np.float64]),
        st.tuples(st.integers(0, 20), st.just(3)),
        elements=st.floats(width=32),
    ),
    st.booleans(),
)
def test_round_trip(points: np.ndarray, double: bool) -> None:
    """What is packed comes back bit by bit, NaN and infinity too."""
    packed = encode_points(points, double=double)
    got = decode_points(packed)
    assert got.dtype == (np.float64 if double else np.float32)
    np.testing.assert_array_equal(got, points)
    assert packed.is_dense == np.isfinite(points).all()
    assert len(packed.data) == packed.row_step == packed.width * packed.point_step


@pytest.mark.parametrize("kind", [*CODES, "?", ">f4", ">u2"])
def test_columns(kind: str) -> None:
    """Further fields of every type stand beside the coordinates."""
    column = np.array([0, 1, 1]).astype(kind)
    packed = encode_points(POINTS, {"value": column})
    assert [f.name for f in packed.fields] == ["x", "y", "z", "value"]
    np.testing.assert_array_equal(decode_points(packed), POINTS)
    got = decode_field(packed, "value")
    np.testing.assert_array_equal(got, column)
    assert got.dtype == (np.uint8 if kind == "?" else np.dtype(kind).newbyteorder("="))


def test_columns_that_do_not_fit() -> None:
    """Wrong length, a name that is taken, a type that the format lacks."""
    with pytest.raises(InputError, match=r"shape \(3,\)"):
        encode_points(POINTS, {"mass": np.ones(2)})
    with pytest.raises(InputError, match="cannot be called 'x'"):
        encode_points(POINTS, {"x": np.ones(3)})
    with pytest.raises(OutputError, match="no type"):
        encode_points(POINTS, {"id": np.ones(3, np.int64)})


def test_coordinates_beyond_float32() -> None:
    """Infinity is not written for what was a number."""
    with pytest.raises(OutputError, match="float32"):
        encode_points([[1e39, 0.0, 0.0]])
    far = [[1e39, 0.0, 0.0]]
    np.testing.assert_array_equal(decode_points(encode_points(far, double=True)), far)


@dataclass
class Stamp:
    sec: int
    nanosec: int


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_stamps(stamp_ns: int) -> None:
    """Nanoseconds survive ROS's two numbers."""
    assert stamp_to_ns(Stamp(*ns_to_stamp(stamp_ns))) == stamp_ns


def test_stamps_out_of_range() -> None:
    """Neither before 1970 nor after 2038."""
    with pytest.raises(InputError, match="negative"):
        stamp_to_ns(Stamp(-1, 5))
    for wrong in (-1, 2**31 * 10**9):
        with pytest.raises(OutputError, match="2147483647"):
            ns_to_stamp(wrong)
