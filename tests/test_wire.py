"""Messages through Arrow and back: all of each, where it lies, and nothing that is wrong."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.errors import InputError, OutputError
from mdcs_pipeline.messages import (
    Header,
    MassCloud,
    Nodes,
    PointCloud,
    RoughSkeleton,
    Skeleton,
    Surface,
    Thickness,
    TransportPlan,
    UnitFrame,
)

pa = pytest.importorskip("pyarrow")
wire = pytest.importorskip("mdcs_pipeline.wire")

HEADER = Header("map", 1_700_000_000_000_000_001, 7)
UNIT = UnitFrame(np.array([1.0, 2, 3]), np.eye(3), 2.5)


def matrix(rows: int, columns: int) -> Any:
    return sparse.random_array((rows, columns), density=0.4, rng=np.random.default_rng(0)).tocsr()


def examples() -> list[Any]:
    """Return a message of every kind, with and without what is optional."""
    rng = np.random.default_rng(5)
    points, half = rng.normal(size=(6, 3)), np.full(2, 0.5)
    nodes = Nodes(
        points[:2], half, rng.normal(size=2), 0.01, np.array([4, 9]), np.array([[0, 1]]),
        np.array([True, False]), np.array([0.1, 0.2]), 3, header=HEADER,
    )  # fmt: skip
    plan = TransportPlan(
        nodes, matrix(6, 2), rng.normal(size=6), 0.01, 5, 1e-4, True, False, (3.0, 2.0)
    )
    graph = sparse.csr_array(np.array([[0, 1.0], [1.0, 0]]))
    ids = np.array([3, 8])
    return [
        PointCloud(points.astype(np.float32), None, HEADER, 2),
        PointCloud(points, np.arange(1.0, 7)),
        PointCloud(np.empty((0, 3))),
        MassCloud(points, np.full(6, 1 / 6), UNIT, HEADER),
        Surface(points[:2], graph),
        Thickness(np.ones(6), np.zeros(6)),
        nodes,
        Nodes(points[:2], half),
        plan,
        RoughSkeleton(plan, np.array([[0, 1]]), np.array([True, True])),
        RoughSkeleton(plan, np.empty((0, 2), np.int64), np.array([False, True])),
        Skeleton(points[:2], np.array([[0, 1]]), half, half, ids, None, HEADER, {"a": [1, None]}),
        Skeleton(points[:2], np.empty((0, 2)), half, half, ids, np.array([0, 1, 1])),
    ]


def equal(found: Any, expected: Any) -> None:
    assert type(found) is type(expected)
    if dataclasses.is_dataclass(expected):
        for item in dataclasses.fields(expected):
            equal(getattr(found, item.name), getattr(expected, item.name))
    elif sparse.issparse(expected):
        assert found.shape == expected.shape
        for part in ("data", "indices", "indptr"):
            np.testing.assert_array_equal(getattr(found, part), getattr(expected, part))
    elif isinstance(expected, np.ndarray):
        assert (found.dtype, found.shape) == (expected.dtype, expected.shape)
        np.testing.assert_array_equal(found, expected)
    else:
        assert found == expected


@pytest.mark.parametrize("message", examples(), ids=lambda m: type(m).__name__)
def test_all_of_a_message_comes_back(message: Any) -> None:
    equal(wire.from_arrow(wire.to_arrow(message), type(message)), message)
    head, held = wire.from_bytes(wire.to_bytes(message, '{"a":"ä"}'))
    assert head == '{"a":"ä"}'
    equal(wire.from_arrow(held, type(message)), message)


def test_a_head_may_come_alone() -> None:
    head, _ = wire.from_bytes(wire.to_bytes(None, "alone"))
    assert head == "alone"


def address(array: np.ndarray) -> tuple[int, int]:
    start: int = array.__array_interface__["data"][0]
    return start, start + array.nbytes


def test_nothing_is_copied() -> None:
    """Looks at addresses: equal values would also come of a copy."""
    cloud = PointCloud(np.random.default_rng(0).normal(size=(1000, 3)), np.ones(1000))
    sent = wire.to_arrow(cloud)
    found = wire.from_arrow(sent, PointCloud)
    assert np.shares_memory(found.positions, cloud.positions)
    assert np.shares_memory(found.weights, cloud.weights)
    assert not found.positions.flags.writeable
    data = wire.to_bytes(cloud, "")
    _, held = wire.from_bytes(data)
    low, high = address(np.frombuffer(data, np.uint8))
    start, end = address(wire.from_arrow(held, PointCloud).positions)
    assert low <= start < end <= high


@dataclass(frozen=True, eq=False)
class Foreign:
    """A message of a stage of another package."""

    grid: NDArray[np.int16]
    mask: NDArray[np.bool_]
    name: str
    share: float
    header: Header
    note: str | None = None


@settings(max_examples=50, deadline=None)
@given(
    grid=hnp.arrays(np.int16, st.tuples(st.integers(0, 5), st.integers(1, 4))),
    mask=hnp.arrays(np.bool_, st.integers(0, 9)),
    name=st.text(),
    share=st.floats(allow_nan=False),
    note=st.none() | st.text(),
)
def test_messages_of_other_packages_travel_too(
    grid: Any, mask: Any, name: str, share: float, note: str | None
) -> None:
    try:
        name.encode(), (note or "").encode()
    except UnicodeEncodeError:
        return
    message = Foreign(grid, mask, name, share, HEADER, note)
    equal(wire.from_arrow(wire.to_arrow(message), Foreign), message)


def test_a_whole_number_may_stand_for_a_float() -> None:
    held = pa.StructArray.from_arrays(
        [
            *(pa.array([[1]], pa.list_(pa.int16())), pa.array([[1]], pa.list_(pa.uint8()))),
            *(pa.array(["n"]), pa.array([2]), wire.to_arrow(HEADER)),
        ],
        ["grid", "mask", "name", "share", "header"],
    )
    assert wire.from_arrow(held, Foreign).share == 2.0


class Odd:
    """No dataclass."""

    def __repr__(self) -> str:
        # Without the address, which would give each worker other names for the same tests.
        return "Odd()"


@dataclass(frozen=True)
class Holding:
    held: Any


@pytest.mark.parametrize(
    "message",
    [
        Odd(),
        Holding(Odd()),
        Holding(np.zeros((2, 2, 2))),
        Holding(np.array(["a"])),
        Holding(np.array([None])),
        Holding((Odd(),)),
        Holding(np.zeros((3, 0))),
    ],
    ids=repr,
)
def test_what_has_no_form_is_refused(message: Any) -> None:
    with pytest.raises(OutputError, match="travel"):
        wire.to_arrow(message)


def spoilt(name: str, value: Any) -> Any:
    """Return a point cloud in Arrow with one field in another form."""
    good = wire.to_arrow(PointCloud(np.ones((2, 3)), np.ones(2), HEADER))
    names = [item.name for item in good.type]
    columns = {n: good.field(k) for k, n in enumerate(names)}
    columns[name] = value
    return pa.StructArray.from_arrays(list(columns.values()), list(columns))


@pytest.mark.parametrize(
    "held",
    [
        pa.array([1, 2]),
        pa.array([{"positions": [1.0]}]),
        pa.array([{"unknown": 1}]),
        pa.array([], pa.struct([("positions", pa.list_(pa.float64()))])),
        spoilt("positions", pa.array([[[1.0, 2.0]]], pa.list_(pa.list_(pa.float64(), 2)))),
        spoilt("positions", pa.array([[float("nan")] * 3])),
        spoilt("positions", pa.array([[1.0, None, 2.0]])),
        spoilt("positions", pa.array(["far"])),
        spoilt("positions", pa.array([None], pa.list_(pa.float64()))),
        spoilt("weights", pa.array([[1.0]])),
        spoilt("weights", pa.array([[-1.0, 1.0]])),
        spoilt("header", pa.array([3])),
        spoilt("header", pa.array([{"frame_id": "a", "stamp_ns": -1, "seq": 0}])),
        spoilt("header", pa.array([{"frame_id": "a", "other": 1}])),
        spoilt("dropped", pa.array(["two"])),
    ],
    ids=str,
)
def test_what_is_no_message_is_refused(held: Any) -> None:
    with pytest.raises(InputError):
        wire.from_arrow(held, PointCloud)


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("indices", [0, 9]),
        ("indices", [0, -1]),
        ("indptr", [0, 5, 2]),
        ("indptr", [0, 2]),
        ("data", [1.0]),
        ("shape", [-1, 2]),
        ("shape", [2]),
    ],
)
def test_a_sparse_matrix_that_would_read_elsewhere_is_refused(part: str, value: Any) -> None:
    parts = {"data": [1.0, 1.0], "indices": [1, 0], "indptr": [0, 1, 2], "shape": [2, 2]}
    graph = pa.array([{**parts, part: value}])
    held = pa.StructArray.from_arrays(
        [wire.to_arrow(PointCloud(np.ones((2, 3)))).field(0), graph], ["positions", "graph"]
    )
    with pytest.raises(InputError):
        wire.from_arrow(held, Surface)


@pytest.mark.parametrize("data", [b"", b"hello", wire.to_bytes(HEADER, "x")[:-40], b"\xff" * 64])
def test_what_is_no_stream_is_refused(data: bytes) -> None:
    with pytest.raises(InputError):
        wire.from_bytes(data)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 255))
def test_a_stream_with_a_wrong_byte_is_a_message_or_refused(place: int, byte: int) -> None:
    data = bytearray(wire.to_bytes(examples()[0], "{}"))
    data[place % len(data)] = byte
    try:
        _, held = wire.from_bytes(bytes(data))
        wire.from_arrow(held, PointCloud)
    except InputError:
        pass


def test_the_documented_schemas_are_those_that_travel() -> None:
    text = (Path(__file__).parents[1] / "docs" / "wire.md").read_text()
    longest: dict[str, str] = {}
    for message in examples():
        name, told = type(message).__name__, wire.describe(message)
        longest[name] = max(longest.get(name, ""), told, key=len)
    for name, told in longest.items():
        assert f"### {name}\n\n```text\n{told}\n```\n" in text
