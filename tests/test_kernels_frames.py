"""What a frame does on a few nodes and voxels: the quick ways tell what the plain ones do."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from mdcs_pipeline.kernels import contact, links
from mdcs_pipeline.kernels.compiled.cheapest import cheapest_site
from mdcs_pipeline.kernels.compiled.common import common_mass
from mdcs_pipeline.kernels.compiled.grid import grid_of, scattered
from mdcs_pipeline.kernels.compiled.pieces import pieces_alike, pieces_near
from mdcs_pipeline.scene.graph import Chain, SceneGraph, SceneNode
from mdcs_pipeline.scene.voxels import VoxelMap

SEEDS = st.integers(0, 100_000)


@given(seed=SEEDS, reach=st.integers(1, 2))
@settings(max_examples=25, deadline=None)
def test_the_nearest_owner_is_that_of_all_voxels_within_reach(seed, reach):
    """Owners are few, and voxels lie on both sides of the origin: cells wrap around there."""
    rng = np.random.default_rng(seed)
    voxels = VoxelMap(0.1)
    voxels.add(rng.uniform(-0.6, 0.6, (300, 3)), 0, 1, 5, 0.35)
    owned = rng.random(voxels.used) < 0.1
    voxels.owner[: voxels.used] = np.where(owned, rng.integers(0, 5, voxels.used), -1)
    asked = rng.permutation(voxels.used)[:150]
    place = voxels.place[: voxels.used]
    cells = np.floor(place / 0.1)
    expected = []
    for slot in asked:
        near = np.flatnonzero(owned & (np.abs(cells - cells[slot]).max(axis=1) <= reach))
        away = np.square(place[near] - place[slot]).sum(axis=1)
        expected.append(voxels.owner[near[np.argmin(away)]] if len(near) else -1)
    np.testing.assert_array_equal(voxels.nearest_owner(asked, reach), expected)


def test_of_owners_equally_near_the_smallest_counts():
    voxels = VoxelMap(1.0)
    voxels.add(np.array([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5], [-0.5, 0.5, 0.5]]), 0, 1, 5, 0.35)
    voxels.owner[1:3] = [7, 4]
    np.testing.assert_array_equal(voxels.nearest_owner(np.array([0]), 1), [4])


@given(seed=SEEDS)
@settings(max_examples=15, deadline=None)
def test_points_within_reach_hang_together(seed):
    places = np.random.default_rng(seed).uniform(-1, 1, (120, 3))
    grid = grid_of(places, 0.3)
    piece = scattered(grid, pieces_near(grid, 0.3))
    count, label = connected_components(cdist(places, places) <= 0.3, directed=False)
    both = np.unique(np.stack([piece, label], axis=1), axis=0)
    assert len(np.unique(piece)) == count == len(both)


def test_neighbours_of_one_owner_hang_together_and_are_numbered_by_their_first():
    """A row of points, of which one owner's lie on both sides of another's."""
    owner = np.array([3, 3, 1, 1, 3, -1])
    row = sparse.diags_array([np.ones(5), np.ones(5)], offsets=[1, -1], shape=(6, 6)).tocsr()
    found = pieces_alike(row.indptr, row.indices, owner)
    np.testing.assert_array_equal(found, [0, 0, 1, 1, 2, 3])


@given(seed=SEEDS)
@settings(max_examples=15, deadline=None)
def test_the_cheapest_site_is_the_least_of_all_costs(seed):
    rng = np.random.default_rng(seed)
    points, nodes = rng.normal(size=(40, 3)), rng.normal(size=(7, 3))
    scale, width = rng.uniform(0.5, 2, 40), rng.uniform(0.5, 2, 7)
    costs = cdist(points, nodes, "sqeuclidean") / (scale[:, None] * width)
    nearest, cost = cheapest_site(points, scale, nodes, width)
    np.testing.assert_array_equal(nearest, costs.argmin(axis=1))
    np.testing.assert_allclose(cost, costs.min(axis=1))


def _plan(rng: np.random.Generator) -> sparse.csr_array:
    dense = rng.random((30, 6)) * (rng.random((30, 6)) < 0.4)
    dense[:, 0] += 0.1
    return sparse.csr_array(dense / dense.sum())


def test_common_mass_is_that_of_the_dense_product():
    rng = np.random.default_rng(0)
    plan, weight = _plan(rng), rng.random(30)
    found = common_mass(plan.indptr, plan.indices, plan.data, weight, 6)
    dense = plan.toarray()
    np.testing.assert_allclose(found, np.triu((dense.T * weight) @ dense, k=1))


def test_few_nodes_and_many_share_and_touch_alike(monkeypatch):
    rng = np.random.default_rng(1)
    plan, mass = _plan(rng), np.full(30, 1 / 30)
    graph = sparse.csr_array((rng.random((30, 30)) < 0.2).astype(float))
    graph = sparse.csr_array(graph + graph.T)
    owner = rng.integers(0, 6, 30)

    def all_of_them() -> tuple[np.ndarray, ...]:
        shared = links.co_transport(plan, mass, 1e-3)
        touching = contact.contacts(graph, owner, 6)
        return *shared, touching.toarray(), contact.relative_contact(touching, shared.pairs)

    few = all_of_them()
    monkeypatch.setattr(links, "_DENSE", 0)
    monkeypatch.setattr(contact, "_DENSE", 0)
    assert len(few[0]) > 3
    for one, other in zip(few, all_of_them(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_pairs_come_sorted_once_and_without_loops():
    pairs = np.array([[2, 1], [0, 3], [1, 2], [4, 4], [0, 1]])
    np.testing.assert_array_equal(links.unique_pairs(pairs), [[0, 1], [0, 3], [1, 2]])
    # Too large for two to make one number.
    far = np.array([[1 << 40, 5], [5, 1 << 40]])
    np.testing.assert_array_equal(links.unique_pairs(far), [[5, 1 << 40]])


def _node(x: float) -> SceneNode:
    return SceneNode(np.array([x, 0.0, 0.0]), 1.0, 1.0, 0.0, 1.0, 1.0, np.empty(0, np.int64))


def test_the_way_around_a_region_ends_once_all_of_its_rim_is_found():
    """A ring of six with one node updated, behind it a tail so long that no search could end."""
    graph, none = SceneGraph(1.0), np.empty(0)
    for name in range(50):
        graph.put(name, _node(float(name)))
    tail = [(5, 6), *((k, k + 1) for k in range(6, 49))]
    for pair in [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (0, 5), *tail]:
        graph.join(pair, Chain(np.empty(0, np.int64), np.empty((0, 3)), none, none))
    assert graph.pieces_beyond([1, 5], {0}, 8) == {1: 1, 5: 1}
    # Without the way around, each is a piece of its own.
    assert graph.pieces_beyond([1, 5], {0, 3}, 100) == {1: 1, 5: 5}


def test_nodes_around_places_far_from_the_origin_are_found():
    graph = SceneGraph(1.0)
    for name, x in enumerate((-1000.5, -999.2, 0.0, 1000.5)):
        graph.put(name, _node(x))
    places = np.array([[-1000.2, 0.1, 0.1], [1000.2, 0.1, 0.1]])
    assert graph.around(places, 0.5) == [0, 1, 3]
