"""Labels, links, merging, filled triangles, cycles and false loops, against brute force."""

from __future__ import annotations

from itertools import combinations

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import chain, line, random_mass, rotation, torus, two_bars, y_shape
from scipy import sparse
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from mdcs_pipeline.kernels import assignment
from mdcs_pipeline.kernels.compiled.shares import top_shares
from mdcs_pipeline.kernels.contact import bodies_touch, contacts, relative_contact
from mdcs_pipeline.kernels.cycles import neighbour_sets, on_cycles, short_cycles, strip_branches
from mdcs_pipeline.kernels.fallen import bodies
from mdcs_pipeline.kernels.insertion import insert_points, inserted_counts
from mdcs_pipeline.kernels.labels import LineRule, line_like, skeletal_nodes
from mdcs_pipeline.kernels.links import (
    Links,
    co_transport,
    gone_on,
    named_pairs,
    shared_mass,
    straight_ahead,
    unique_pairs,
    widened,
)
from mdcs_pipeline.kernels.merging import close_pairs, inherited, merge, merging_pairs
from mdcs_pipeline.kernels.nerve import filled_triangles, open_triangles
from mdcs_pipeline.kernels.problem import Accuracy, Problem
from mdcs_pipeline.kernels.seeding import spread_points
from mdcs_pipeline.kernels.separation import Rings, contracted, false_loops, surroundings
from mdcs_pipeline.kernels.sinkhorn import solve_free
from mdcs_pipeline.kernels.spanning import piece_labels, spanning_links
from mdcs_pipeline.kernels.surface import surface_graph
from mdcs_pipeline.kernels.symmetry import asymmetry, false_cycle_nodes

SEEDS = st.integers(0, 100_000)
NONE = np.empty((0, 2), np.int64)


def random_plan(seed: int, n: int = 30, m: int = 6) -> tuple[np.ndarray, sparse.csr_array]:
    """Masses of points and a plan of a few entries a row that carries them."""
    rng = np.random.default_rng(seed)
    mass = random_mass(rng, n)
    dense = rng.uniform(0, 1, (n, m)) ** 3 * (rng.uniform(0, 1, (n, m)) < 0.6)
    dense[np.arange(n), rng.integers(0, m, n)] += 0.5
    dense *= (mass / dense.sum(axis=1))[:, None]
    return mass, sparse.csr_array(dense)


def random_graph(seed: int, count: int = 9, edges: int = 12) -> np.ndarray:
    rng = np.random.default_rng(seed)
    every = np.array(list(combinations(range(count), 2)))
    return every[np.sort(rng.choice(len(every), min(edges, len(every)), replace=False))]


def as_nx(count: int, pairs: np.ndarray) -> nx.Graph:
    graph = nx.Graph()
    graph.add_nodes_from(range(count))
    graph.add_edges_from(pairs.tolist())
    return graph


def cycle_rank(count: int, pairs: np.ndarray) -> int:
    graph = as_nx(count, pairs)
    return len(pairs) - count + nx.number_connected_components(graph)


def free_plan(points: np.ndarray, nodes: np.ndarray, epsilon: float) -> sparse.csr_array:
    n, m = len(points), len(nodes)
    problem = Problem(
        points, np.full(n, 1 / n), nodes, np.full(m, 1 / m), epsilon, np.ones(n), np.ones(m)
    )
    return solve_free(problem, np.zeros(m), Accuracy()).plan


# ------------------------------------------------------------------------------------ labels


def test_line_like_points_are_those_of_the_text():
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 0]])
    top = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 3], [0, 1, -1], [0, 4, 1], [0, -1, -1]])
    shares = np.array(
        [[0.4, 0.3, 0.3], [0.6, 0.395, 0.005], [0.5, 0.3, 0.2], [0.5, 0.4, 0.0], [0.5, 0.3, 0.2],
         [0.9, 0.0, 0.0]]
    )  # fmt: skip
    # Straight; two hold nearly all; a corner; only two; the first's place is no direction; one.
    wanted = [True, True, False, True, False, True]
    assert line_like(nodes, top, shares, LineRule()).tolist() == wanted


def test_the_cosine_of_the_rule_is_the_angle_at_the_first_node():
    shares = np.array([[0.4, 0.3, 0.3]])
    for degrees, wanted in [(180, True), (156, True), (152, False), (90, False), (0, False)]:
        turn = np.deg2rad(degrees)
        nodes = np.array([[0.0, 0, 0], [2, 0, 0], [3 * np.cos(turn), 3 * np.sin(turn), 0]])
        # cos 154.2° = −0.9
        found = line_like(nodes, np.array([[0, 1, 2]]), shares, LineRule())
        assert found.tolist() == [wanted]


def test_a_node_is_skeletal_when_nine_tenths_of_its_points_are_line_like():
    major = np.repeat([0, 1, 2], [10, 10, 3])
    lines = np.ones(23, dtype=bool)
    lines[[0, 10, 11]] = False
    assert skeletal_nodes(4, major, lines, 0.9).tolist() == [True, False, True, False]


# ------------------------------------------------------------------------------------- links


def test_unique_pairs_are_sorted_and_without_loops():
    pairs = np.array([[3, 1], [1, 3], [2, 2], [0, 1]])
    assert unique_pairs(pairs).tolist() == [[0, 1], [1, 3]]
    assert unique_pairs(np.array([[2, 2]])).shape == (0, 2)
    assert unique_pairs(NONE).shape == (0, 2)


def test_a_point_names_its_second_node_and_the_third_if_it_needs_three():
    top = np.array([[0, 1, 2], [3, 4, 5], [6, 7, -1], [8, -1, -1]])
    shares = np.array([[0.5, 0.3, 0.2], [0.7, 0.295, 0.005], [0.5, 0.4, 0.0], [1.0, 0, 0]])
    assert named_pairs(top, shares, 0.99).tolist() == [[0, 1], [0, 2], [3, 4], [6, 7]]


@given(seed=SEEDS, floor=st.sampled_from([0.0, 0.01, 0.1]))
@settings(max_examples=25, deadline=None)
def test_shared_mass_and_co_transport_are_their_sums(seed, floor):
    mass, plan = random_plan(seed)
    dense = plan.toarray()
    node_mass = dense.sum(axis=0)
    counted = dense > floor * mass[:, None]
    shared, walked = {}, {}
    for i, k in combinations(range(6), 2):
        both = counted[:, i] & counted[:, k]
        if both.any():
            shared[i, k] = (dense[both, i] + dense[both, k]).sum()
            walk = (dense[both, i] * dense[both, k] / mass[both]).sum()
            walked[i, k] = walk / min(node_mass[i], node_mass[k])
    for found, wanted in [
        (shared_mass(plan, floor), shared),
        (co_transport(plan, mass, floor), walked),
    ]:
        assert [tuple(pair) for pair in found.pairs.tolist()] == list(wanted)
        np.testing.assert_allclose(found.strength, list(wanted.values()))


def test_nodes_without_common_points_are_not_linked():
    plan = sparse.csr_array(np.diag([0.5, 0.5]))
    for found in (shared_mass(plan, 0.0), co_transport(plan, np.full(2, 0.5), 0.0)):
        assert found.pairs.shape == (0, 2)
        assert found.strength.shape == (0,)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_what_goes_on_from_an_end_is_ahead_of_it(unit: float) -> None:
    """A limb along x from node 0 to 2, nodes ahead, behind and beside, and a second limb."""
    nodes = unit * np.array(
        [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [1, 2, 0], [2, 2, 0], [3, 2, 0], [3, 1, 0]],
        dtype=float,
    )
    edges = np.array([[0, 1], [1, 2], [4, 5], [5, 6]])
    pairs = np.array([[2, 3], [1, 3], [2, 5], [1, 5], [0, 6], [2, 6], [2, 2]])
    # Node 3 has no edges and looks anywhere; 1 and 5 are inner nodes.
    root, back = np.sqrt(0.5), -3 / np.sqrt(13)
    # From 0 the way to 6 leads back, from 6 it leads back too.
    wanted = [[1, 1], [-1, 1], [0, -1], [-1, -1], [back, back], [5**-0.5, -(5**-0.5)], [0, 0]]
    found = straight_ahead(nodes, edges, pairs)
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    aslant = straight_ahead(nodes, np.concatenate([edges, [[3, 7]]]), np.array([[2, 7]]))
    np.testing.assert_allclose(aslant, [[root, -root]], atol=1e-12)


def straighter(least: float, count: int) -> np.ndarray:
    """Return what is asked of the straighter of a link's two nodes alone."""
    return np.tile([least, -1.0], (count, 1))


def test_an_end_goes_straight_on_along_its_strongest_link() -> None:
    """A rail along x from node 0 to 4, and a rung from 5 to 7 that stops short of it."""
    rail = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [4, 0, 0]]
    nodes = np.array([*rail, [2, 3, 0], [2, 2, 0], [2, 1, 0]], dtype=float)
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [5, 6], [6, 7]])
    pairs = np.array([[3, 7], [2, 7], [2, 6], [4, 5]])

    def added(strength: list[float], least: float = 0.7) -> set[tuple[int, ...]]:
        found = gone_on(nodes, edges, Links(pairs, np.array(strength)), straighter(least, 4))
        assert {tuple(pair) for pair in edges.tolist()} <= {tuple(pair) for pair in found.tolist()}
        return {tuple(pair) for pair in found.tolist()} - {tuple(pair) for pair in edges.tolist()}

    # 3 is 45° off the way, from 5 it leads back, and 6 is no end.
    assert added([1.0, 0.1, 1.0, 1.0]) == {(3, 7)}
    assert added([0.1, 1.0, 1.0, 1.0]) == {(2, 7)}
    assert added([1.0, 0.1, 1.0, 1.0], 0.75) == {(2, 7)}
    assert added([1.0, 0.1, 1.0, 1.0], 1.0) == {(2, 7)}
    none = Links(np.empty((0, 2), np.int64), np.empty(0))
    nothing = gone_on(nodes, edges, none, straighter(0.7, 0))
    np.testing.assert_array_equal(nothing, edges)


def test_two_ends_that_face_each_other_share_one_link() -> None:
    nodes = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], dtype=float)
    edges = np.array([[0, 1], [2, 3]])
    facing = Links(np.array([[1, 2], [0, 2], [1, 3]]), np.array([0.9, 0.5, 0.5]))
    found = gone_on(nodes, edges, facing, straighter(0.7, 3))
    assert found.tolist() == [[0, 1], [1, 2], [2, 3]]


def test_a_weak_link_must_go_straight_on_from_both_its_nodes() -> None:
    """Two limbs in line, a gap between them, a third beside, and a node on its own."""
    nodes = np.array(
        [[0, 0, 0], [1, 0, 0], [5, 0, 0], [6, 0, 0], [3, 1, 0], [3, 4, 0], [8, 0, 0]], dtype=float
    )
    edges = np.array([[0, 1], [2, 3], [4, 5]])

    def added(pairs: list[list[int]], both: float) -> list[list[int]]:
        links = Links(np.array(pairs), np.full(len(pairs), 0.01))
        least = np.tile([0.7, both], (len(pairs), 1))
        return [pair for pair in gone_on(nodes, edges, links, least).tolist() if pair in pairs]

    assert added([[1, 2]], 0.5) == [[1, 2]]
    # From 1 node 4 is 27° off, from 4 node 1 is 63°.
    assert added([[1, 4]], 0.5) == []
    assert added([[1, 4]], 0.4) == [[1, 4]]
    # A node on its own looks anywhere, one in the middle of a limb nowhere.
    assert added([[3, 6]], 0.5) == [[3, 6]]
    assert added([[2, 6]], 0.5) == []


def test_a_widened_plan_is_that_of_the_same_potentials_at_the_larger_epsilon():
    rng = np.random.default_rng(0)
    points, nodes = rng.uniform(0, 1, (40, 3)), rng.uniform(0, 1, (5, 3))
    square = cdist(points, nodes, "sqeuclidean")
    mass = random_mass(rng, 40)

    def plan(epsilon: float) -> np.ndarray:
        rows = np.exp(-square / epsilon)
        return rows * (mass / rows.sum(axis=1))[:, None]

    found = widened(sparse.csr_array(plan(0.1)), mass, 3.0)
    np.testing.assert_allclose(found.toarray(), plan(0.3), rtol=1e-10)


# ----------------------------------------------------------------------------------- merging


def merging_by_hand(nodes, mass, skeletal, pairs):
    near = neighbour_sets(len(nodes), pairs)
    free, chosen = set(range(len(nodes))), []
    for i in sorted(np.flatnonzero(~skeletal), key=lambda i: mass[i]):
        if i in free and near[i]:
            j = min(near[i], key=lambda j: np.linalg.norm(nodes[i] - nodes[j]))
            if j in free:
                free -= {i, j}
                chosen.append([int(i), j])
    return chosen


@given(seed=SEEDS, edges=st.integers(0, 20))
@settings(max_examples=40, deadline=None)
def test_unsettled_nodes_merge_by_rising_mass_with_their_nearest_partner(seed, edges):
    rng = np.random.default_rng(seed)
    nodes, mass = rng.uniform(0, 1, (10, 3)), random_mass(rng, 10)
    skeletal = rng.uniform(0, 1, 10) < 0.3
    pairs = random_graph(seed, 10, edges)
    found = merging_pairs(nodes, mass, skeletal, pairs)
    assert found.tolist() == merging_by_hand(nodes, mass, skeletal, pairs)
    assert len(np.unique(found)) == found.size
    assert not skeletal[found[:, 0]].any()
    assert (np.diff(mass[found[:, 0]]) > 0).all()


@given(seed=SEEDS)
@settings(max_examples=30, deadline=None)
def test_a_merge_keeps_mass_and_its_centre(seed):
    rng = np.random.default_rng(seed)
    nodes, mass = rng.uniform(0, 1, (9, 3)), random_mass(rng, 9)
    pairs = rng.permutation(9)[: 2 * rng.integers(0, 5)].reshape(-1, 2)
    merged = merge(nodes, mass, pairs)
    assert len(merged.positions) == 9 - len(pairs)
    assert merged.mass.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(merged.mass @ merged.positions, mass @ nodes)
    for i, j in pairs:
        at = merged.into[i]
        assert merged.into[j] == at
        assert merged.kept[at] == i
        centre = (mass[i] * nodes[i] + mass[j] * nodes[j]) / (mass[i] + mass[j])
        np.testing.assert_allclose(merged.positions[at], centre)
        assert merged.mass[at] == pytest.approx(mass[i] + mass[j])
    np.testing.assert_array_equal(merged.into[merged.kept], np.arange(len(merged.kept)))
    alone = np.setdiff1d(np.arange(9), pairs)
    np.testing.assert_array_equal(merged.positions[merged.into[alone]], nodes[alone])


def test_nodes_that_carry_nothing_meet_half_way():
    merged = merge(np.array([[0.0, 0, 0], [2, 0, 0]]), np.zeros(2), np.array([[0, 1]]))
    assert merged.positions.tolist() == [[1.0, 0, 0]]


def test_a_merge_inherits_the_links_of_both_nodes():
    pairs = np.array([[0, 1], [1, 2], [0, 3], [2, 3]])
    merged = merge(np.zeros((4, 3)), np.ones(4), np.array([[0, 1]]))
    assert inherited(pairs, merged.into).tolist() == [[0, 1], [0, 2], [1, 2]]


@given(seed=SEEDS, spacing=st.floats(0.3, 2.0))
@settings(max_examples=30, deadline=None)
def test_close_pairs_are_the_closest_in_radii(seed, spacing):
    rng = np.random.default_rng(seed)
    nodes, scale = rng.uniform(0, 1, (14, 3)), rng.uniform(0.1, 0.4, 14)
    every = [
        (np.linalg.norm(nodes[i] - nodes[j]) / min(scale[i], scale[j]), i, j)
        for i, j in combinations(range(14), 2)
    ]
    taken, wanted = set(), []
    for gap, i, j in sorted(every):
        if gap < spacing and not {i, j} & taken:
            taken |= {i, j}
            wanted.append([i, j])
    assert close_pairs(nodes, scale, spacing).tolist() == wanted


def test_no_pairs_are_close_where_all_are_far():
    assert close_pairs(np.eye(3), np.full(3, 0.1), 1.0).shape == (0, 2)


# ------------------------------------------------------------------------------------- nerve


def boundary_rank(edges: list[tuple[int, int]], triangles: list[tuple[int, int, int]]) -> int:
    """Rank modulo 2 of the boundaries of the triangles."""
    bits = {edge: 1 << k for k, edge in enumerate(edges)}
    pivots: dict[int, int] = {}
    for a, b, c in triangles:
        left = bits[a, b] ^ bits[a, c] ^ bits[b, c]
        while left:
            high = left.bit_length()
            if high not in pivots:
                pivots[high] = left
                break
            left ^= pivots[high]
    return len(pivots)


def test_a_filled_triangle_loses_its_longest_edge_and_a_hollow_one_none():
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [0.2, 0.5, 0]])
    pairs = np.array([[0, 1], [0, 2], [1, 2]])
    assert open_triangles(nodes, pairs, np.array([[0, 1, 2]])).tolist() == [[0, 2], [1, 2]]
    assert open_triangles(nodes, pairs, np.empty((0, 3), np.int64)).tolist() == pairs.tolist()


def test_a_triangle_without_all_its_edges_is_left():
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [0.2, 0.5, 0]])
    pairs = np.array([[0, 1], [1, 2]])
    assert open_triangles(nodes, pairs, np.array([[0, 1, 2]])).tolist() == pairs.tolist()
    assert open_triangles(nodes, NONE, np.array([[0, 1, 2]])).shape == (0, 2)


@pytest.mark.xfail(strict=True, reason="a filled square keeps its rim; the check finds it later")
def test_two_filled_triangles_on_one_longest_edge_leave_no_hole():
    """Their square is filled, but both are done with when the diagonal goes.

    Opening the square too (elimination of boundaries modulo 2) gives the holes of the complex
    exactly, and was worse on the benchmark: sheets of nodes on thick parts then turn into
    trees, while their leftover loops are what the check widens the radius for.
    """
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0.9, 0], [0, 0.9, 0]])
    pairs = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]])
    found = open_triangles(nodes, pairs, np.array([[0, 1, 2], [0, 2, 3]]))
    assert piece_labels(4, found).max() == 0
    assert cycle_rank(4, found) == 0


@given(seed=SEEDS, share=st.floats(0, 1))
@settings(max_examples=60, deadline=None)
def test_opening_keeps_the_pieces_and_every_hole_of_the_complex(seed, share):
    rng = np.random.default_rng(seed)
    nodes = rng.uniform(0, 1, (8, 3))
    pairs = random_graph(seed, 8, 16)
    edges = [tuple(pair) for pair in pairs.tolist()]
    triangles = [
        (a, b, c)
        for a, b, c in combinations(range(8), 3)
        if {(a, b), (a, c), (b, c)} <= set(edges) and rng.uniform() < share
    ]
    found = open_triangles(nodes, pairs, np.array(triangles, np.int64).reshape(-1, 3))
    assert {tuple(pair) for pair in found.tolist()} <= set(edges)
    assert piece_labels(8, found).max() == piece_labels(8, pairs).max()
    holes = cycle_rank(8, pairs) - boundary_rank(edges, triangles)
    assert holes <= cycle_rank(8, found) <= cycle_rank(8, pairs)
    # No triangle is left that is filled and still has all its edges.
    left = {tuple(pair) for pair in found.tolist()}
    assert not any({(a, b), (a, c), (b, c)} <= left for a, b, c in triangles)


def test_triangles_are_filled_by_enough_common_points():
    top = np.array([[2, 0, 1, -1], [0, 1, 2, 3], [0, 1, 3, -1]])
    shares = np.array([[0.5, 0.3, 0.2, 0.0], [0.5, 0.3, 0.19, 0.005], [0.6, 0.3, 0.1, 0.0]])
    assert filled_triangles(top, shares, 0.01, 1).tolist() == [[0, 1, 2], [0, 1, 3]]
    assert filled_triangles(top, shares, 0.01, 2).tolist() == [[0, 1, 2]]
    assert filled_triangles(top, shares, 0.001, 1).tolist() == [
        [0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3],
    ]  # fmt: skip
    assert filled_triangles(top, shares, 0.9, 1).shape == (0, 3)
    assert filled_triangles(top[:, :2], shares[:, :2], 0.01, 1).shape == (0, 3)


def linked(points: np.ndarray, nodes: np.ndarray, epsilon: float) -> tuple[np.ndarray, np.ndarray]:
    """Edges by co-transport before and after filled triangles are opened."""
    plan = free_plan(points, nodes, epsilon)
    links = co_transport(plan, np.full(len(points), 1 / len(points)), 1e-3)
    pairs = links.pairs[links.strength > 0.01]
    top, shares = top_shares(plan.indptr, plan.indices, plan.data, 6)
    return pairs, open_triangles(nodes, pairs, filled_triangles(top, shares, 0.01, 1))


def test_a_torus_keeps_one_cycle_and_trees_none():
    shape = torus(1500)
    for step in (2, 4):
        _, found = linked(shape.points, shape.nodes[::step], 0.012 * step)
        count = len(shape.nodes[::step])
        assert cycle_rank(count, found) == 1
        assert piece_labels(count, found).max() == 0
    for made, pieces in ((line(1000), 1), (y_shape(1500), 1), (two_bars(1500), 2)):
        nodes = made.nodes[::2]
        before, found = linked(made.points, nodes, 0.02)
        assert cycle_rank(len(nodes), before) > 0, "there is something to open"
        assert cycle_rank(len(nodes), found) == 0
        assert piece_labels(len(nodes), found).max() + 1 == pieces


# ---------------------------------------------------------------------------------- spanning


@given(seed=SEEDS, edges=st.integers(0, 14))
@settings(max_examples=30, deadline=None)
def test_pieces_are_the_connected_components(seed, edges):
    pairs = random_graph(seed, 10, edges)
    label = piece_labels(10, pairs)
    wanted = {frozenset(piece) for piece in nx.connected_components(as_nx(10, pairs))}
    assert {frozenset(np.flatnonzero(label == k).tolist()) for k in np.unique(label)} == wanted
    assert sorted(set(label.tolist())) == list(range(len(wanted)))


def test_pieces_join_by_their_strongest_link_and_weak_ones_stay_out():
    pairs = np.array([[0, 1], [2, 3], [4, 5]])
    candidates = Links(
        np.array([[0, 2], [1, 3], [3, 4], [0, 1], [5, 6]]), np.array([0.2, 0.5, 0.3, 0.9, 0.01])
    )
    found = spanning_links(7, pairs, candidates, 0.1)
    assert found.tolist() == [[0, 1], [1, 3], [2, 3], [3, 4], [4, 5]]
    np.testing.assert_array_equal(spanning_links(7, pairs, candidates, 0.95), pairs)
    assert spanning_links(7, pairs, candidates, 0.01).tolist()[-1] == [5, 6]


@given(seed=SEEDS)
@settings(max_examples=30, deadline=None)
def test_spanning_adds_a_maximum_spanning_forest_of_the_pieces(seed):
    rng = np.random.default_rng(seed)
    pairs, others = random_graph(seed, 10, 5), random_graph(seed + 1, 10, 14)
    strength = rng.permutation(len(others)) / len(others)
    found = spanning_links(10, pairs, Links(others, strength), 0.3)
    assert {tuple(p) for p in pairs.tolist()} <= {tuple(p) for p in found.tolist()}
    strong = others[strength >= 0.3]
    whole = as_nx(10, np.concatenate([pairs, strong]))
    assert piece_labels(10, found).max() + 1 == nx.number_connected_components(whole)
    assert cycle_rank(10, found) == cycle_rank(10, pairs)
    graph = nx.Graph()
    for (i, j), weight in zip(strong.tolist(), strength[strength >= 0.3], strict=True):
        graph.add_edge(i, j, weight=weight)
    for i, j in pairs.tolist():
        graph.add_edge(i, j, weight=2.0)
    best = nx.maximum_spanning_tree(graph)
    wanted = {tuple(sorted(e)) for e in best.edges} | {tuple(p) for p in pairs.tolist()}
    assert {tuple(p) for p in found.tolist()} == wanted


# ------------------------------------------------------------------------------------ cycles


def cyclic_edges(count: int, pairs: np.ndarray) -> set[tuple[int, int]]:
    graph = as_nx(count, pairs)
    return set(map(tuple, pairs.tolist())) - {tuple(sorted(e)) for e in nx.bridges(graph)}


@given(seed=SEEDS, edges=st.integers(0, 16))
@settings(max_examples=40, deadline=None)
def test_every_edge_on_a_cycle_has_a_shortest_one(seed, edges):
    pairs = random_graph(seed, 9, edges)
    found = short_cycles(9, pairs)
    assert len({frozenset(cycle) for cycle in found}) == len(found)
    present = set(map(tuple, pairs.tolist()))
    shortest: dict[tuple[int, int], int] = {}
    for cycle in found:
        around = [tuple(sorted(p)) for p in zip(cycle, cycle[1:] + cycle[:1], strict=True)]
        assert len(set(cycle)) == len(cycle) >= 3
        assert set(around) <= present
        for edge in around:
            shortest[edge] = min(shortest.get(edge, 99), len(cycle))
    wanted = {}
    for i, j in cyclic_edges(9, pairs):
        graph = as_nx(9, pairs)
        graph.remove_edge(i, j)
        wanted[i, j] = nx.shortest_path_length(graph, i, j) + 1
    assert shortest == wanted
    inside = sorted({i for edge in wanted for i in edge})
    assert np.flatnonzero(on_cycles(9, pairs)).tolist() == inside


def test_known_graphs_have_their_cycles():
    ring = chain(5, closed=True)
    assert [sorted(c) for c in short_cycles(5, ring)] == [[0, 1, 2, 3, 4]]
    assert short_cycles(5, chain(5)) == []
    grid = nx.convert_node_labels_to_integers(nx.grid_2d_graph(3, 4))
    assert [len(c) for c in short_cycles(12, np.array(sorted(grid.edges)))] == 6 * [4]
    # Two rings on a bridge: the bridge and its inner node are on none.
    pairs = np.array([[0, 1], [1, 2], [0, 2], [2, 3], [3, 4], [4, 5], [5, 6], [4, 6]])
    assert np.flatnonzero(~on_cycles(7, pairs)).tolist() == [3]
    assert not on_cycles(3, NONE).any()


@given(seed=SEEDS, edges=st.integers(0, 16))
@settings(max_examples=30, deadline=None)
def test_stripping_leaves_the_two_core(seed, edges):
    pairs = random_graph(seed, 10, edges)
    near = neighbour_sets(10, pairs)
    strip_branches(near)
    core = nx.k_core(as_nx(10, pairs), 2)
    assert {(i, j) for i in range(10) for j in near[i] if i < j} == {
        tuple(sorted(e)) for e in core.edges
    }


# ---------------------------------------------------------------------------------- symmetry


def one_node(offsets: np.ndarray, mass: np.ndarray | None = None, floor: float = 0.01) -> float:
    n = len(offsets)
    mass = np.full(n, 1 / n) if mass is None else mass
    plan = sparse.csr_array(mass[:, None])
    node = np.array([[3.0, -2.0, 1.0]])
    return float(asymmetry(plan, node - offsets, mass, node, floor)[0])


def skewed(seed: int, n: int = 60) -> np.ndarray:
    """Offsets whose principal directions are far from degenerate."""
    rng = np.random.default_rng(seed)
    return rng.standard_normal((n, 3)) * [3.0, 1.0, 0.3] @ rotation(seed).T


def test_a_one_sided_set_has_imbalance_1_and_a_symmetric_one_0():
    rng = np.random.default_rng(0)
    sided = np.column_stack([rng.uniform(1, 2, 50), 0.1 * rng.standard_normal((50, 2))])
    assert one_node(sided) == 1.0
    half = skewed(0)
    assert one_node(np.concatenate([half, -half])) == pytest.approx(0.0, abs=1e-12)


@given(seed=SEEDS)
@settings(max_examples=25, deadline=None)
def test_the_imbalance_is_the_text_formula_and_does_not_turn(seed):
    offsets, mass = skewed(seed), random_mass(np.random.default_rng(seed), 60)
    _, axes = np.linalg.eigh(offsets.T @ offsets)
    along = offsets @ axes
    plus, minus = mass @ (along > 0), mass @ (along < 0)
    wanted = np.max(np.abs(plus - minus) / (plus + minus))
    assert one_node(offsets, mass) == pytest.approx(wanted, abs=1e-12)
    assert one_node(offsets @ rotation(seed + 1).T, mass) == pytest.approx(wanted, abs=1e-12)


def test_only_points_that_give_the_node_enough_count():
    half = skewed(0, 20)
    points = np.concatenate([half, -half, [[5.0, 4.0, 3.0]]])
    nodes, mass = np.array([[0.0, 0, 0], [9, 9, 9], [0, 5, 0]]), np.full(41, 1 / 41)
    shares = np.tile([0.5, 0.5, 0.0], (41, 1))
    shares[40] = [0.005, 0.995, 0.0]
    plan = sparse.csr_array(shares / 41)
    assert asymmetry(plan, points, mass, nodes, 0.01)[0] == pytest.approx(0.0, abs=1e-12)
    assert asymmetry(plan, points, mass, nodes, 0.001)[0] == pytest.approx(1 / 41)
    # A node without points.
    assert asymmetry(plan, points, mass, nodes, 0.01)[2] == 0.0


def test_false_cycles_are_walked_from_candidates_to_symmetric_nodes():
    ring, some = chain(6, closed=True), np.zeros(6, dtype=bool)
    some[[0, 2, 4]] = True
    assert false_cycle_nodes(6, ring, some).all()
    # The edge between two symmetric nodes is not walked, so the walk does not come around.
    some[2] = False
    assert not false_cycle_nodes(6, ring, some).any()
    assert not false_cycle_nodes(6, NONE, some).any()
    with_tail = np.concatenate([ring, [[5, 6]]])
    found = false_cycle_nodes(7, with_tail, np.ones(7, dtype=bool))
    assert found.tolist() == 6 * [True] + [False]


# -------------------------------------------------------------------------------- separation


def nearest_node(points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    return cKDTree(nodes).query(points)[1].astype(np.int64)


def adjacent(graph: sparse.csr_array, owner: np.ndarray, count: int) -> np.ndarray:
    """Pairs of nodes whose points touch well."""
    touching = contacts(graph, owner, count)
    pairs = unique_pairs(np.argwhere(touching.toarray() > 0))
    return pairs[relative_contact(touching, pairs) > 0.2]


def test_surroundings_are_the_points_within_some_links():
    rng = np.random.default_rng(0)
    graph = surface_graph(rng.uniform(0, 1, (80, 3)), 4, 0).graph
    inside = np.zeros(80, dtype=bool)
    inside[:5] = True
    steps = sparse.csgraph.shortest_path(graph, unweighted=True, indices=np.arange(5)).min(axis=0)
    for hops in (1, 2, 3):
        wanted = np.flatnonzero((steps > 0) & (steps <= hops))
        assert sorted(surroundings(graph, inside, hops).tolist()) == wanted.tolist()
    assert surroundings(graph, inside, 0).shape == (0,)
    # All inside: nothing is left around, however far one goes.
    assert surroundings(graph, np.ones(80, dtype=bool), 3).shape == (0,)
    assert surroundings(graph, np.zeros(80, dtype=bool), 3).shape == (0,)


def test_a_loop_of_nodes_on_the_wall_is_false():
    """Patches on the wall of a thick tube can be walked around, so that their loops are false."""
    shape = line(3000, radius=0.3)
    graph = surface_graph(shape.points, 8, 0).graph
    nodes = shape.points[spread_points(shape.points, 40, 0)]
    owner = nearest_node(shape.points, nodes)
    pairs = adjacent(graph, owner, 40)
    loops = false_loops(40, pairs, Rings(graph, owner, 2), 0.3, 0.5)
    every = short_cycles(40, pairs)
    assert len(every) > 20
    assert len(loops) >= 0.85 * len(every)


@pytest.mark.parametrize("count", [5, 10, 20])
def test_the_loop_of_a_torus_is_not_false(count):
    shape = torus(3000)
    graph = surface_graph(shape.points, 8, 0).graph
    nodes = shape.nodes[:: 40 // count]
    owner = nearest_node(shape.points, nodes)
    pairs = chain(count, closed=True)
    assert short_cycles(count, pairs)
    assert false_loops(count, pairs, Rings(graph, owner, 2), 0.3, 0.5) == []


def test_half_a_torus_wall_keeps_its_loop_too():
    """A scan from one side opens every tube; the gap must still not be walked around."""
    shape = torus(6000)
    seen = shape.points[shape.points[:, 2] > 0]
    graph = surface_graph(seen, 8, 0).graph
    owner = nearest_node(seen, shape.nodes[::4])
    assert false_loops(10, chain(10, closed=True), Rings(graph, owner, 2), 0.3, 0.5) == []


def test_a_node_without_points_or_neighbours_leads_nowhere():
    shape = line(300)
    graph = surface_graph(shape.points, 8, 0).graph
    owner = (shape.points[:, 0] > 0.5).astype(np.int64)
    rings = Rings(graph, owner, 2)
    assert not rings.leads_around(2, 0, 1, 0.3)
    # Node 2 owns nothing, so that no piece of a ring is its.
    assert not rings.leads_around(0, 1, 2, 0.3)
    assert rings.leads_around(0, 1, 1, 0.3)
    assert false_loops(3, np.array([[0, 1], [0, 2], [1, 2]]), rings, 0.3, 0.5) == []


def test_a_loop_needs_its_majority():
    """Two of four nodes on a wide patch, two around a narrow neck."""

    class Half:
        def leads_around(self, node, one, other, overlap):
            return node < 2

    ring = chain(4, closed=True)
    assert len(false_loops(4, ring, Half(), 0.3, 0.5)) == 1
    assert false_loops(4, ring, Half(), 0.3, 0.51) == []


# --------------------------------------------------------------------------------- insertion


@given(length=st.floats(1e-3, 1e3), spacing=st.floats(1e-2, 1e2))
@settings(max_examples=200, deadline=None)
def test_the_count_of_inserted_points_is_that_of_equation_7(length, spacing):
    count = int(inserted_counts(np.array([length]), spacing)[0])
    assert length / (count + 1) <= spacing * (1 + 1e-9)
    if count:
        assert spacing * (1 - 1e-9) < length / count
    else:
        assert length <= spacing * (1 + 1e-9)


def test_an_edge_of_the_spacing_or_shorter_is_not_cut():
    assert inserted_counts(np.array([1.0, 0.5, 2.0, 3.0, 2.5]), 1.0).tolist() == [0, 0, 1, 2, 2]
    # Three times 0.1 is a little more than 0.3.
    assert inserted_counts(np.array([3 * 0.1]), 0.1).tolist() == [2]


@given(seed=SEEDS, spacing=st.floats(0.05, 2.0))
@settings(max_examples=30, deadline=None)
def test_insertion_keeps_the_shape_and_interpolates(seed, spacing):
    rng = np.random.default_rng(seed)
    nodes, edges = rng.uniform(0, 1, (7, 3)), random_graph(seed, 7, 8)
    # A value that is linear in the place stays so only if it is interpolated linearly.
    slope = rng.standard_normal((3, 2))
    found = insert_points(nodes, nodes @ slope, edges, spacing)
    np.testing.assert_array_equal(found.positions[:7], nodes)
    np.testing.assert_allclose(found.values, found.positions @ slope, atol=1e-12)
    ends = found.positions[found.edges]
    lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    assert lengths.max() <= spacing * (1 + 1e-9)
    before = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
    assert lengths.sum() == pytest.approx(before.sum())
    assert (found.edges[:, 0] < found.edges[:, 1]).all()
    count = len(found.positions)
    assert cycle_rank(count, found.edges) == cycle_rank(7, edges)
    assert piece_labels(count, found.edges).max() == piece_labels(7, edges).max()
    degree = np.bincount(found.edges.ravel(), minlength=count)
    np.testing.assert_array_equal(degree[:7], np.bincount(edges.ravel(), minlength=7))
    assert (degree[7:] == 2).all()


def test_a_graph_without_edges_gets_no_points():
    found = insert_points(np.eye(3), np.ones((3, 1)), NONE, 0.1)
    assert len(found.positions) == 3
    assert found.edges.shape == (0, 2)


# ----------------------------------------------------------------- assignment and contact


@pytest.mark.parametrize("block", [1 << 22, 50])
def test_owners_are_the_cells_of_the_power_diagram(block, monkeypatch):
    monkeypatch.setattr(assignment, "_BLOCK", block)
    rng = np.random.default_rng(0)
    points, nodes, f = rng.uniform(0, 1, (60, 3)), rng.uniform(0, 1, (7, 3)), rng.normal(0, 0.1, 7)
    r, s = rng.uniform(0.5, 2, 60), rng.uniform(0.5, 2, 7)
    wanted = [
        max(range(7), key=lambda i: f[i] - ((nodes[i] - y) ** 2).sum() / (s[i] * rj))
        for y, rj in zip(points, r, strict=True)
    ]
    assert assignment.owners(points, nodes, f, r, s).tolist() == wanted


def test_contacts_count_the_neighbours_across():
    graph = surface_graph(np.random.default_rng(0).uniform(0, 1, (40, 3)), 4, 0).graph
    owner = np.random.default_rng(1).integers(0, 5, 40)
    wanted = np.zeros((6, 6))
    for a, b in zip(*graph.nonzero(), strict=True):
        if owner[a] != owner[b]:
            wanted[owner[a], owner[b]] += 1
    found = contacts(graph, owner, 6)
    np.testing.assert_array_equal(found.toarray(), wanted)
    np.testing.assert_array_equal(wanted, wanted.T)
    pairs = np.array([[0, 1], [2, 4], [0, 5]])
    largest = wanted.max(axis=1)
    ratio = [wanted[0, 1] / min(largest[[0, 1]]), wanted[2, 4] / min(largest[[2, 4]]), 0.0]
    np.testing.assert_allclose(relative_contact(found, pairs), ratio)
    assert relative_contact(found, NONE).shape == (0,)


def test_strays_of_a_node_are_not_its_body_and_make_no_touch():
    """A bar of nodes 0 and 1, and node 2 apart, to which the bar's last points belong."""
    bar = np.column_stack([np.arange(10.0), np.zeros(10), np.zeros(10)])
    apart = bar[:6] + np.array([15.0, 0, 0])
    points = np.concatenate([bar, apart])
    owner = np.repeat([0, 1, 2], [4, 4, 8])
    links = np.abs(np.subtract.outer(points[:, 0], points[:, 0])) == 1.0
    graph = sparse.csr_array(links.astype(float))
    body = bodies(graph, owner, 0.7)
    assert np.flatnonzero(~body).tolist() == [8, 9]
    pairs = np.array([[0, 1], [1, 2], [0, 2], [0, 3]])
    assert relative_contact(contacts(graph, owner, 4), pairs)[1] > 0
    assert bodies_touch(graph, owner, body, pairs).tolist() == [True, False, False, False]
    # A part of at least the share asked for is no stray: half of a limb may be hidden.
    assert bodies(graph, owner, 2 / 6).all()
    assert bodies_touch(graph, owner, bodies(graph, owner, 2 / 6), pairs)[1]
    assert bodies(sparse.csr_array((0, 0)), np.empty(0, np.int64), 0.7).shape == (0,)
    assert bodies_touch(graph, owner, body, NONE).shape == (0,)


def test_false_loops_shrink_to_a_point_and_true_ones_stay():
    # A sheet of points is walked around everywhere: its loop of four is a disc.
    x, y = np.meshgrid(np.arange(12.0), np.arange(12.0))
    sheet = np.column_stack([x.ravel(), y.ravel(), np.zeros(144)])
    nodes = np.array([[2.5, 2.5, 0], [8.5, 2.5, 0], [8.5, 8.5, 0], [2.5, 8.5, 0]])
    pairs = np.array([[0, 1], [1, 2], [2, 3], [0, 3]])
    graph = surface_graph(sheet, 8, 0).graph
    found = contracted(4, pairs, graph, nearest_node(sheet, nodes), 3, 0.3, 0.5)
    assert found.tolist() == [0, 0, 0, 0]
    # The nodes of a ring cut it in two wherever they stand.
    angle = np.arange(120) * 2 * np.pi / 120
    ring = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    graph = surface_graph(ring, 2, 0).graph
    owner = np.arange(120) // 30
    assert contracted(4, pairs, graph, owner, 3, 0.3, 0.5).tolist() == [0, 1, 2, 3]
