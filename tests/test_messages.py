"""Messages: what each refuses, what it keeps, and that it leaves its maker's arrays alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import FrozenInstanceError, fields
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest
import shapes
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

NAN = float("nan")
POINTS = np.arange(12, dtype=np.float64).reshape(4, 3)
QUARTERS = np.full(4, 0.25)
#: Two points and three nodes; every point's mass is given whole.
SHARES = np.array([[0.25, 0.25, 0.0], [0.0, 0.1, 0.4]])


def unit(**values: Any) -> UnitFrame:
    return UnitFrame(**{"centre": np.zeros(3), "axes": np.eye(3), "length": 1.0, **values})


def cloud(**values: Any) -> PointCloud:
    return PointCloud(**{"positions": POINTS, **values})


def measure(**values: Any) -> MassCloud:
    return MassCloud(**{"positions": POINTS, "mass": QUARTERS, "unit": unit(), **values})


def surface(**values: Any) -> Surface:
    graph = sparse.csr_array(np.array([[0, 2.0], [2.0, 0]]))
    return Surface(**{"positions": POINTS[:2], "graph": graph, **values})


def thickness(**values: Any) -> Thickness:
    return Thickness(**{"radius": np.ones(4), "confidence": np.full(4, 0.5), **values})


def nodes(**values: Any) -> Nodes:
    given = {"positions": POINTS[:3], "mass": [0.25, 0.35, 0.4], "links": [[0, 1], [1, 2]]}
    return Nodes(**{**given, **values})


def plan(**values: Any) -> TransportPlan:
    given = {
        "nodes": nodes(),
        "plan": sparse.csr_array(SHARES),
        "point_potentials": np.zeros(2),
        "epsilon": 0.5,
        "iterations": 3,
        "marginal_error": 1e-4,
        "converged": True,
        "warm": False,
    }
    return TransportPlan(**{**given, **values})


def rough(**values: Any) -> RoughSkeleton:
    given = {"plan": plan(), "edges": [[0, 1]], "skeletal": [True, False, True]}
    return RoughSkeleton(**{**given, **values})


def skeleton(**values: Any) -> Skeleton:
    given = {
        "nodes": POINTS,
        "edges": [[0, 1], [1, 2], [1, 3]],
        "mass": QUARTERS,
        "radius": [0.5, 0.5, 0.25, 0.0],
        "node_ids": [7, 3, 9, 11],
    }
    return Skeleton(**{**given, **values})


MAKERS: dict[type, Callable[..., Any]] = {
    PointCloud: cloud,
    UnitFrame: unit,
    MassCloud: measure,
    Surface: surface,
    Thickness: thickness,
    Nodes: nodes,
    TransportPlan: plan,
    RoughSkeleton: rough,
    Skeleton: skeleton,
}


# --- what is refused

REFUSED = [
    (cloud, {"positions": POINTS[:, :2]}, r"positions must have the shape \(N, 3\)"),
    (cloud, {"positions": POINTS.ravel()}, r"shape \(12,\)"),
    (cloud, {"positions": [[0, 0, NAN]]}, "positions must be finite"),
    (cloud, {"positions": [[0, 0, np.inf], [NAN, 0, 0]]}, "2 values that are NaN or infinite"),
    (cloud, {"positions": [["a", "b", "c"]]}, "must hold real numbers"),
    (cloud, {"positions": [[1, 2, 3j]]}, "dtype complex128"),
    (cloud, {"positions": [[1, 2, 3], [4, 5]]}, "positions is not an array"),
    (cloud, {"weights": np.ones(3)}, r"weights must have the shape \(4\)"),
    (cloud, {"weights": [1, 1, 0, 1]}, "weights must be positive"),
    (cloud, {"weights": [1, 1, NAN, 1]}, "weights must be finite"),
    (unit, {"centre": np.zeros(2)}, r"centre must have the shape \(3\)"),
    (unit, {"axes": np.eye(2)}, r"axes must have the shape \(3, 3\)"),
    (unit, {"axes": 2 * np.eye(3)}, "axes must be orthonormal"),
    (unit, {"axes": np.diag([1, 1, -1])}, "right-handed"),
    (unit, {"length": 0.0}, "length must be positive"),
    (unit, {"length": NAN}, "length must be positive"),
    (measure, {"positions": POINTS.T}, r"positions must have the shape \(any, 3\)"),
    (measure, {"mass": np.full(3, 1 / 3)}, r"mass must have the shape \(4\)"),
    (measure, {"mass": [0.5, 0.5, 0.5, -0.5]}, "mass must be non-negative and sum to 1"),
    (measure, {"mass": np.ones(4)}, "sum 4"),
    (surface, {"graph": sparse.csr_array((2, 3))}, "one row for each of 2 points"),
    (surface, {"graph": sparse.csr_array([[0, -1.0], [1, 0]])}, "distances must be positive"),
    (surface, {"graph": sparse.csr_array([[0, NAN], [1, 0]])}, "graph must be finite"),
    (surface, {"positions": [[0, 0, NAN], [0, 0, 1]]}, "positions must be finite"),
    (thickness, {"radius": [1, 1, 0, 1]}, "radius must be positive"),
    (thickness, {"radius": np.ones((4, 1))}, r"radius must have the shape \(any\)"),
    (thickness, {"confidence": np.ones(3)}, r"confidence must have the shape \(4\)"),
    (nodes, {"mass": [1, 0, NAN]}, "mass must be finite"),
    (nodes, {"potentials": np.zeros(2)}, r"potentials must have the shape \(3\)"),
    (nodes, {"epsilon": 0.0}, "epsilon must be positive"),
    (nodes, {"epsilon": np.inf}, "epsilon must be positive"),
    (nodes, {"ids": [1, 2]}, r"ids must have the shape \(3\)"),
    (nodes, {"ids": [0.5, 1, 2]}, "ids must hold whole numbers\n  received: 0.5"),
    (nodes, {"ids": [1e300, 1, 2]}, "ids must hold whole numbers"),
    (nodes, {"links": [[0, 3]]}, "links must name nodes 0 to 2"),
    (nodes, {"links": [[-1, 2]]}, "links must name nodes 0 to 2"),
    (nodes, {"settled": [True]}, r"settled must have the shape \(3\)"),
    (nodes, {"settled": [0, 1, 2]}, "settled must hold truth values\n  received: 2"),
    (nodes, {"scale": [1, 1, 0]}, "scale must be positive"),
    (plan, {"plan": sparse.csr_array(SHARES.T)}, "one column for each of 3 nodes"),
    (plan, {"plan": sparse.csr_array(-SHARES)}, "the plan must not be negative"),
    (plan, {"plan": sparse.csr_array(SHARES * NAN)}, "plan must be finite"),
    (plan, {"epsilon": -1.0}, "epsilon must be positive"),
    (plan, {"point_potentials": np.zeros(3)}, r"point_potentials must have the shape \(2\)"),
    (rough, {"edges": [[1, 1]]}, "with i < j in every pair"),
    (rough, {"edges": [[2, 1]]}, "with i < j in every pair"),
    (rough, {"edges": [[0, 1], [0, 1]]}, "edges must name every pair once"),
    (rough, {"edges": [[0.0, 1.0]]}, "array of integers"),
    (rough, {"edges": [0, 1]}, r"\(E, 2\) array of integers"),
    (rough, {"skeletal": [True]}, r"skeletal must have the shape \(3\)"),
    (skeleton, {"nodes": np.zeros((4, 2))}, r"nodes must have the shape \(any, 3\)"),
    (skeleton, {"edges": [[0, 4]]}, "edges must name nodes 0 to 3"),
    (skeleton, {"mass": np.zeros(4)}, "sum to 1"),
    (skeleton, {"radius": [1, 1, 1, -1e-9]}, "radius must not be negative"),
    (skeleton, {"node_ids": [1, 1, 2, 3]}, "node_ids must be unique"),
    (skeleton, {"assignment": [0, 4]}, "assignment must name nodes 0 to 3"),
    (skeleton, {"assignment": [-1]}, "assignment must name nodes 0 to 3"),
    (skeleton, {"assignment": [[0]]}, r"assignment must have the shape \(any\)"),
    (Header, {"frame_id": 3}, "frame_id must be text"),
    (Header, {"stamp_ns": -1}, "stamp_ns must be a non-negative integer"),
    (Header, {"stamp_ns": 1.5}, "stamp_ns must be a non-negative integer"),
    (Header, {"seq": True}, "seq must be a non-negative integer"),
]


@pytest.mark.parametrize(("make", "values", "said"), REFUSED)
def test_faulty_messages_are_refused(
    make: Callable[..., Any], values: dict[str, Any], said: str
) -> None:
    make()
    with pytest.raises(InputError, match=said):
        make(**values)


# --- what is kept


@pytest.mark.parametrize("make", MAKERS.values(), ids=lambda make: make.__name__)
def test_messages_are_frozen_and_hold_read_only_views(make: Callable[..., Any]) -> None:
    message = make()
    for item in fields(message):
        with pytest.raises(FrozenInstanceError):
            setattr(message, item.name, None)
        value = getattr(message, item.name)
        held = [value.data, value.indices, value.indptr] if sparse.issparse(value) else [value]
        for array in held:
            if isinstance(array, np.ndarray):
                with pytest.raises(ValueError, match="read-only"):
                    array[...] = 0


@pytest.mark.parametrize(
    ("make", "name", "array"),
    [
        (cloud, "positions", POINTS.copy()),
        (cloud, "weights", np.ones(4)),
        (unit, "axes", np.eye(3)),
        (measure, "mass", QUARTERS.copy()),
        (thickness, "radius", np.ones(4)),
        (nodes, "potentials", np.ones(3)),
        (nodes, "settled", np.ones(3, bool)),
        (nodes, "links", np.array([[0, 1]])),
        (skeleton, "nodes", POINTS.copy()),
        (skeleton, "assignment", np.zeros(9, np.int64)),
    ],
)
def test_the_makers_array_stays_writable_and_is_not_copied(
    make: Callable[..., Any], name: str, array: np.ndarray
) -> None:
    before = array.copy()
    held = getattr(make(**{name: array}), name)
    assert array.flags.writeable
    assert np.shares_memory(held, array)
    np.testing.assert_array_equal(array, before)


@pytest.mark.parametrize(("make", "name"), [(surface, "graph"), (plan, "plan")])
def test_the_makers_matrix_stays_writable_and_is_not_copied(
    make: Callable[..., Any], name: str
) -> None:
    """The arrays alone were looked at once; the matrix around them had been made read-only."""
    given = sparse.csr_array(SHARES if name == "plan" else np.array([[0, 2.0], [2.0, 0]]))
    held = getattr(make(**{name: given}), name)
    assert held is not given
    for part in ("data", "indices", "indptr"):
        assert getattr(given, part).flags.writeable
        assert np.shares_memory(getattr(held, part), getattr(given, part))


@pytest.mark.parametrize(
    ("dtype", "kept"),
    [
        (np.float32, np.float32),
        (np.float64, np.float64),
        (np.float16, np.float64),
        (np.int64, np.float64),
        (np.uint8, np.float64),
        (">f8", np.float64),
        (">f4", np.float64),
    ],
)
def test_point_types(dtype: Any, kept: type) -> None:
    given = POINTS.astype(dtype)
    held = cloud(positions=given).positions
    assert held.dtype == np.dtype(kept)
    assert held.dtype.isnative
    np.testing.assert_array_equal(held, POINTS)


@pytest.mark.parametrize(
    "given",
    [
        np.asfortranarray(POINTS),
        np.repeat(POINTS, 2, axis=0)[::2],
        POINTS[::-1][::-1],
        POINTS.tolist(),
        np.broadcast_to(POINTS, (4, 3)),
    ],
)
def test_memory_layouts(given: Any) -> None:
    for held in (cloud(positions=given).positions, skeleton(nodes=given).nodes):
        assert held.flags.c_contiguous
        np.testing.assert_array_equal(held, POINTS)


def test_whole_floats_and_small_integers_name_nodes() -> None:
    assert nodes(ids=[4.0, 2.0, 9.0]).ids.tolist() == [4, 2, 9]
    assert nodes(settled=[0, 1, 1]).settled.tolist() == [False, True, True]
    edges = skeleton(edges=np.array([[0, 1]], np.uint8)).edges
    assert edges.dtype == np.int64


def test_nodes_fill_in_what_is_not_given() -> None:
    made = nodes(links=np.empty((0, 2)))
    assert made.ids.tolist() == [0, 1, 2]
    assert made.potentials.tolist() == [0, 0, 0]
    assert made.settled.tolist() == [False] * 3
    assert made.scale.tolist() == [1, 1, 1]
    assert made.links.shape == (0, 2)
    assert made.epsilon is None


def test_messages_without_points() -> None:
    nothing = np.empty((0, 3))
    assert len(cloud(positions=nothing, weights=np.empty(0))) == 0
    assert len(measure(positions=nothing, mass=[])) == 0
    assert len(nodes(positions=nothing, mass=[], links=[])) == 0
    assert thickness(radius=[], confidence=[]).summary() == {"radius": 0.0}
    assert surface(positions=nothing, graph=sparse.csr_array((0, 0))).summary() == {"links": 0}
    empty = skeleton(
        nodes=nothing, edges=[], mass=[], radius=[], node_ids=[], assignment=np.empty(0)
    )
    assert set(empty.summary().values()) == {0}


def test_figures_of_a_progress_line() -> None:
    assert cloud().summary() == {"points": 4} == measure().summary()
    assert surface().summary() == {"links": 1}
    assert thickness(radius=[1, 2, 3, 5]).summary() == {"radius": 2.5}
    assert nodes(epsilon=0.5).summary() == {"nodes": 3, "epsilon": 0.5}
    assert plan().summary() == {"nodes": 3, "epsilon": 0.5, "passes": 3, "entries": 0}
    assert rough().summary() == {"nodes": 3, "edges": 1, "epsilon": 0.5, "skeletal": 2}
    assert rough().nodes is not None
    assert len(skeleton()) == 4


def test_the_unit_frame_leads_there_and_back() -> None:
    frame = unit(centre=[5, -3, 1e3], axes=shapes.turned(4), length=7.0)
    there = frame.to_unit(POINTS)
    np.testing.assert_allclose(frame.from_unit(there), POINTS, atol=1e-12)
    # The first axis, a length away from the centre, is the first unit vector.
    place = frame.centre + 7.0 * frame.axes[0]
    np.testing.assert_allclose(frame.to_unit(place[None]), [[1, 0, 0]], atol=1e-12)


# --- skeletons as graphs


@pytest.mark.parametrize(
    ("count", "edges", "wanted"),
    [
        (1, [], (1, 0, 0, 0)),
        (3, [], (3, 0, 0, 0)),
        (4, [[0, 1], [1, 2], [2, 3]], (1, 0, 2, 0)),
        (4, [[0, 1], [1, 2], [1, 3]], (1, 0, 3, 1)),
        (3, [[0, 1], [1, 2], [0, 2]], (1, 1, 0, 0)),
        # A figure of eight, its crossing in node 2.
        (5, [[0, 1], [1, 2], [0, 2], [2, 3], [3, 4], [2, 4]], (1, 2, 0, 1)),
        # A ring with a tail, a rod, a lone node.
        (7, [[0, 1], [1, 2], [0, 2], [2, 3], [4, 5]], (3, 1, 3, 1)),
        # All pairs of four nodes.
        (4, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]], (1, 3, 0, 4)),
    ],
)
def test_counts_of_known_graphs(
    count: int, edges: list[list[int]], wanted: tuple[int, int, int, int]
) -> None:
    made = Skeleton(
        nodes=np.arange(3.0 * count).reshape(count, 3),
        edges=np.array(edges, np.int64).reshape(-1, 2),
        mass=np.full(count, 1 / count),
        radius=np.ones(count),
        node_ids=np.arange(count),
    )
    found = made.summary()
    assert found.pop("nodes") == count
    assert found.pop("edges") == len(edges)
    assert found == dict(zip(("components", "cycles", "leaves", "junctions"), wanted, strict=True))
    graph = made.to_networkx()
    assert nx.number_connected_components(graph) == wanted[0]
    assert len(nx.cycle_basis(graph)) == wanted[1]


def test_networkx_attributes() -> None:
    made = skeleton()
    graph = made.to_networkx()
    assert list(graph.nodes) == [7, 3, 9, 11]
    assert graph.nodes[9] == {"position": (6.0, 7.0, 8.0), "mass": 0.25, "radius": 0.25}
    assert set(map(frozenset, graph.edges)) == {frozenset(p) for p in ((7, 3), (3, 9), (3, 11))}
    assert graph.edges[3, 11]["length"] == pytest.approx(6 * np.sqrt(3))
    kinds = {type(v) for data in graph.nodes.values() for v in data.values()}
    assert kinds == {tuple, float}


@pytest.mark.parametrize("suffix", [".json", ".npz"])
@pytest.mark.parametrize("assignment", [None, np.array([0, 0, 3, 2, 1])])
def test_a_saved_skeleton_comes_back(
    tmp_path: Path, suffix: str, assignment: np.ndarray | None
) -> None:
    made = skeleton(
        nodes=POINTS / 3,
        assignment=assignment,
        header=Header("map", 12, 3),
        diagnostics={"rounds": {"a": 1}, "converged": True, "epsilon": 0.1 + 0.2},
    )
    made.save(tmp_path / f"s{suffix}")
    back = Skeleton.load(tmp_path / f"s{suffix}")
    for name in ("nodes", "edges", "mass", "radius", "node_ids", "assignment"):
        np.testing.assert_array_equal(getattr(back, name), getattr(made, name))
    assert back.header == made.header
    assert back.diagnostics == made.diagnostics


def test_a_skeleton_file_with_a_wrong_header_or_array_says_where(tmp_path: Path) -> None:
    path = tmp_path / "s.json"
    skeleton().save(path)
    good = path.read_text()
    for old, new, said in (
        ('"seq"', '"number"', "header: .*number"),
        ('"seq": 0', '"seq": -1', "seq must be a non-negative integer"),
        ('"mass": [0.25', '"mass": [0.75', "sum to 1"),
    ):
        assert old in good
        path.write_text(good.replace(old, new))
        with pytest.raises(InputError, match=said) as caught:
            Skeleton.load(path)
        assert str(path) in str(caught.value)


def test_an_unknown_suffix_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="suffix"):
        skeleton().save(tmp_path / "s.docx")
    assert not list(tmp_path.iterdir())


def test_a_line_set_holds_nodes_and_edges() -> None:
    pytest.importorskip("open3d")
    lines = skeleton().to_lineset()
    np.testing.assert_array_equal(np.asarray(lines.points), POINTS)
    assert np.asarray(lines.lines).tolist() == [[0, 1], [1, 2], [1, 3]]


def test_a_late_plan_is_made_once_when_it_is_asked_for():
    made = []

    def make() -> sparse.csr_array:
        made.append(1)
        return sparse.csr_array(SHARES)

    rest = {k: v for k, v in vars(plan()).items() if k != "plan"}
    late = TransportPlan.late(make, **rest)
    again = late.serving(nodes(settled=[True, False, True]))
    assert (late.summary(), made) == (plan().summary(), [])
    np.testing.assert_array_equal(again.plan.toarray(), SHARES)
    assert again.nodes.settled.tolist() == [True, False, True]
    np.testing.assert_array_equal(late.plan.toarray(), SHARES)
    assert late.plan is late.plan
    assert made == [1]
    assert not late.plan.data.flags.writeable
    with pytest.raises(AttributeError, match="nothing"):
        _ = late.nothing


def test_a_late_plan_is_checked_like_any_other():
    rest = {k: v for k, v in vars(plan()).items() if k != "plan"}
    late = TransportPlan.late(lambda: sparse.csr_array(-SHARES), **rest)
    with pytest.raises(InputError, match="the plan must not be negative"):
        _ = late.plan
