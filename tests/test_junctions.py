"""Limbs that leave a node together: a plate with a limb on its side, and any graph."""

from __future__ import annotations

from typing import NamedTuple

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.arrays import BoolArray
from mdcs_pipeline.kernels.junctions import parted
from mdcs_pipeline.messages import (
    MassCloud,
    Nodes,
    RoughSkeleton,
    Surface,
    TransportPlan,
    UnitFrame,
)
from mdcs_pipeline.stages.junction import Junction

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

STEP = 0.04
UNIT = UnitFrame(np.zeros(3), np.eye(3), 1.0)
#: Two halves of a plate, the root of a limb on its side, and the limb.
NODES = np.array([[-0.6, 0.05, 0.0], [0.6, 0.05, 0.0], [0.0, -0.35, 0.0], [0.0, -0.8, 0.0]])
EDGES = np.array([[0, 2], [1, 2], [2, 3]])


def strip(x: tuple[float, float], y: tuple[float, float]) -> FloatArray:
    """Return a grid of points, a step apart."""
    sides = [np.arange(low, high + 1e-9, STEP) for low, high in (x, y)]
    return np.stack(
        [*map(np.ravel, np.meshgrid(*sides)), np.zeros(len(sides[0]) * len(sides[1]))], 1
    )


PLATE = np.concatenate([strip((-1, 1), (-0.4, 0.4)), strip((-0.16, 0.16), (-1, -0.44))])
BARS = np.concatenate([strip((-1, 1), (-0.16, 0.16)), strip((-0.16, 0.16), (-1, -0.2))])


class Given(NamedTuple):
    """What the stage takes."""

    cloud: MassCloud
    rough: RoughSkeleton
    surface: Surface


def taken(points: FloatArray, nodes: FloatArray, edges: IntArray, **more: object) -> Given:
    """Return the nodes with the plan of softened Voronoi cells."""
    square = ((points[:, None] - nodes) ** 2).sum(axis=2)
    share = np.exp(-square / 0.04)
    plan = share / share.sum(axis=1, keepdims=True) / len(points)
    held = Nodes(nodes, plan.sum(axis=0), **more)  # type: ignore[arg-type]
    served = TransportPlan(
        held, sparse.csr_array(plan), np.zeros(len(points)), 0.04, 1, 0.0, True, False
    )
    apart = np.abs(points[:, None] - points).max(axis=2)
    near = sparse.csr_array(((apart < 1.5 * STEP) & (apart > 0)).astype(np.float64))
    cloud = MassCloud(points, np.full(len(points), 1 / len(points)), UNIT)
    rough = RoughSkeleton(served, edges, np.ones(len(nodes), dtype=np.bool_))
    return Given(cloud, rough, Surface(points, near))


def test_two_halves_of_a_plate_meet_in_its_middle_and_not_in_the_root_of_a_limb() -> None:
    held = taken(PLATE, NODES, EDGES)
    got = Junction()(*held).rough
    assert got.edges.tolist() == [[0, 4], [1, 4], [2, 3], [2, 4]]
    place = got.nodes.positions[4]
    assert abs(place[0]) < 1e-9
    assert -0.25 < place[1] < 0.05
    # It carries nothing yet: mass and plan are those of the nodes that were there.
    assert got.nodes.mass.tolist() == [*held.rough.nodes.mass, 0.0]
    assert got.plan.plan.toarray()[:, :4].tolist() == held.rough.plan.plan.toarray().tolist()
    assert not got.plan.plan.toarray()[:, 4].any()
    assert len(set(got.nodes.ids.tolist())) == 5


def test_three_limbs_meet_in_one_place_whichever_side_of_their_triangle_is_open() -> None:
    nodes = np.concatenate([NODES, [[-0.95, 0.05, 0.0], [0.95, 0.05, 0.0]]])
    limbs, sides = [[2, 3], [0, 4], [1, 5]], [[0, 1], [0, 2], [1, 2]]
    places = []
    for k in range(3):
        edges = np.array(limbs + sides[:k] + sides[k + 1 :])
        got = Junction()(*taken(PLATE, nodes, edges)).rough
        assert got.edges.tolist() == [[0, 4], [0, 6], [1, 5], [1, 6], [2, 3], [2, 6]]
        places.append(got.nodes.positions[6])
    assert np.allclose(places, places[0], atol=1e-12)
    # As far along the plate from one half of it as from the other.
    assert abs(places[0][0]) < 1e-9


def test_limbs_that_meet_in_a_node_go_on_meeting_there() -> None:
    nodes = np.array([[-0.6, 0.0, 0.0], [0.6, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, -0.6, 0.0]])
    held = taken(BARS, nodes, EDGES)
    assert Junction()(*held).rough is held.rough


def test_a_chain_and_the_middle_of_a_disc_have_no_limbs_that_part() -> None:
    chain = taken(PLATE, NODES[:3], EDGES[:2])
    assert Junction()(*chain).rough is chain.rough
    around = 0.5 * np.array([[1, 0, 0], [-0.5, 0.8, 0], [-0.5, -0.8, 0], [0, 0, 0]])
    grid = strip((-1, 1), (-1, 1))
    disc = grid[np.linalg.norm(grid, axis=1) < 0.9]
    middle = taken(disc, around, np.array([[0, 3], [1, 3], [2, 3]]))
    assert Junction()(*middle).rough is middle.rough


@pytest.mark.parametrize("node", [0, 2])
def test_edges_of_what_surrounds_an_update_stay(node: int) -> None:
    held = taken(PLATE, NODES, EDGES, fixed=np.arange(4) == node)
    assert Junction()(*held).rough is held.rough


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_nodes_and_points_and_where_they_lie_make_no_difference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    order, turn = rng.permutation(4), np.linalg.qr(rng.normal(size=(3, 3)))[0]
    mixed = rng.permutation(len(PLATE))
    there = Junction()(*taken(PLATE, NODES, EDGES)).rough
    held = taken(PLATE[mixed], NODES[order], np.sort(np.argsort(order)[EDGES], axis=1))
    got = Junction()(*held).rough
    assert np.allclose(got.nodes.positions[4], there.nodes.positions[4])
    names = np.append(order, 4)
    assert {frozenset(pair) for pair in names[got.edges].tolist()} == {
        frozenset(pair) for pair in there.edges.tolist()
    }
    turned = held._replace(
        rough=RoughSkeleton(
            held.rough.plan.serving(
                Nodes(held.rough.nodes.positions @ turn, held.rough.nodes.mass)
            ),
            held.rough.edges,
            held.rough.skeletal,
        ),
        cloud=MassCloud(held.cloud.positions @ turn, held.cloud.mass, UNIT),
    )
    moved = Junction()(*turned).rough.nodes.positions[4]
    assert np.allclose(moved, there.nodes.positions[4] @ turn)


@st.composite
def graphs(draw: st.DrawFn) -> tuple[int, IntArray, IntArray, BoolArray]:
    """Return any graph, triangles between its nodes, and which of their sides are firm."""
    count = draw(st.integers(4, 12))
    pair = st.tuples(st.integers(0, count - 1), st.integers(0, count - 1))
    chosen = {tuple(sorted(p)) for p in draw(st.lists(pair, max_size=20)) if p[0] != p[1]}
    triple = st.lists(st.integers(0, count - 1), min_size=3, max_size=3, unique=True)
    triangles = sorted({tuple(sorted(t)) for t in draw(st.lists(triple, max_size=20))})
    sides = st.lists(st.booleans(), min_size=3 * len(triangles), max_size=3 * len(triangles))
    firm = np.array(draw(sides), dtype=np.bool_).reshape(-1, 3)
    edges = np.array(sorted(chosen), dtype=np.int64).reshape(-1, 2)
    return count, edges, np.array(triangles, dtype=np.int64).reshape(-1, 3), firm


@given(graphs())
def test_pieces_loops_and_ends_of_any_graph_stay(
    made: tuple[int, IntArray, IntArray, BoolArray],
) -> None:
    count, edges, triangles, firm = made
    found = parted(count, edges, triangles, firm, np.zeros(count, dtype=np.bool_))
    before, after = nx.empty_graph(count), nx.empty_graph(count + len(found.beside))
    before.add_edges_from(edges.tolist())
    after.add_edges_from(found.edges.tolist())
    assert nx.number_connected_components(after) == nx.number_connected_components(before)
    assert after.number_of_edges() - len(after) == before.number_of_edges() - len(before)
    ends = [[n for n in graph if graph.degree(n) == 1] for graph in (before, after)]
    assert ends[0] == ends[1]
    assert all(after.degree(n) >= 3 for n in range(count, len(after)))
