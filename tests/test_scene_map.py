"""The voxel map, the node graph and their way into a checkpoint and back."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from mdcs_pipeline.errors import InputError
from mdcs_pipeline.kernels.compiled.hashing import FARTHEST
from mdcs_pipeline.messages import Header, PointCloud
from mdcs_pipeline.scene.graph import Chain, SceneGraph, SceneNode, pair_of
from mdcs_pipeline.scene.integrate import FrameRule, add_frame
from mdcs_pipeline.scene.state import Scene
from mdcs_pipeline.scene.voxels import VoxelMap

SIZE = 0.5


def cells(points: np.ndarray) -> list[tuple[int, ...]]:
    return [tuple(c) for c in np.floor(points / SIZE).astype(int).tolist()]


def place(held: VoxelMap, slot: int) -> tuple[int, ...]:
    key = int(held.key[slot])
    half = 1 << 20
    return tuple(((key >> shift) & ((1 << 21) - 1)) - half for shift in (42, 21, 0))


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(0, 2**31), st.integers(1, 120), st.booleans()),
        min_size=1,
        max_size=8,
    )
)
def test_the_map_counts_as_a_dictionary_would(frames: list[tuple[int, int, bool]]) -> None:
    """Additions and removals in any order; freed slots are used again."""
    held = VoxelMap(SIZE)
    truth: dict[tuple[int, ...], list[np.ndarray]] = defaultdict(list)
    for number, (seed, count, forget) in enumerate(frames):
        rng = np.random.default_rng(seed)
        points = rng.uniform(-3, 3, (count, 3))
        touched, fresh, moved = held.add(points, number, 1, 100, 0.3)
        for cell, point in zip(cells(points), points, strict=True):
            truth[cell].append(point)
        assert {place(held, s) for s in touched} == set(cells(points))
        assert not set(fresh.tolist()) & set(moved.tolist())
        if forget:
            gone = touched[::2]
            for slot in gone:
                del truth[place(held, slot)]
            held.drop(gone)
    filled = np.flatnonzero(held.key[: held.used] >= 0)
    assert len(held) == len(filled) == len(truth)
    for slot in filled:
        expected = truth[place(held, slot)]
        assert held.count[slot] == len(expected)
        np.testing.assert_allclose(held.total[slot], np.sum(expected, axis=0), atol=1e-12)


def test_a_voxel_is_surface_from_its_least_hits_on() -> None:
    held = VoxelMap(SIZE)
    point = np.full((1, 3), 0.1)
    _, fresh, _ = held.add(point, 0, 3, 100, 0.3)
    assert not len(fresh)
    _, fresh, _ = held.add(point, 1, 3, 100, 0.3)
    assert not len(fresh)
    _, fresh, moved = held.add(point, 2, 3, 100, 0.3)
    assert len(fresh) == 1
    assert not len(moved)


def first(points: np.ndarray) -> Scene:
    scene = Scene()
    add_frame(scene, PointCloud(points, header=Header("map", 1, 0)), FrameRule(voxel_size=1.0))
    return scene


def spread(count: int, hits: int) -> np.ndarray:
    """Return `hits` points in the middle of each of `count` voxels that lie apart."""
    at = np.arange(count)[:, None] * [3.0, 0.0, 0.0] + 0.5
    return np.repeat(at - at.mean(axis=0).round(), hits, axis=0)


def test_a_sparse_first_frame_is_all_surface() -> None:
    """1,500 points fall into nearly as many voxels; none of them was surface before."""
    scene = first(spread(50, 1))
    assert scene.world is not None
    assert np.count_nonzero(scene.world.voxels.live) == 50
    assert len(scene.changed) == 50


def test_a_dense_first_frame_keeps_its_stray_points_out() -> None:
    dense, stray = spread(20, 3), spread(40, 1) + np.array([0.0, 50.0, 0.0])
    scene = first(np.concatenate([dense, stray]))
    assert scene.world is not None
    assert np.count_nonzero(scene.world.voxels.live) == 20


def test_a_sparse_frame_later_on_is_not_taken_at_its_word() -> None:
    scene = first(spread(20, 3))
    more = PointCloud(spread(20, 1) + np.array([0.0, 50.0, 0.0]), header=Header("map", 2, 1))
    add_frame(scene, more, FrameRule(voxel_size=1.0))
    assert scene.world is not None
    assert np.count_nonzero(scene.world.voxels.live) == 20


def test_hits_that_come_too_seldom_are_noise() -> None:
    held = VoxelMap(SIZE)
    point = np.full((1, 3), 0.1)
    for frame in range(0, 100, 4):
        _, fresh, _ = held.add(point, frame, 3, 5, 0.3)
        assert not len(fresh)


def test_a_centroid_that_moves_is_told_once_it_has_moved_far() -> None:
    held = VoxelMap(SIZE)
    held.add(np.full((1, 3), 0.05), 0, 1, 9, 0.3)
    held.pending[:] = False
    assert not len(held.add(np.full((1, 3), 0.10), 1, 1, 9, 0.3)[2])
    told = held.add(np.full((8, 3), 0.45), 2, 1, 9, 0.3)[2]
    assert len(told) == 1
    np.testing.assert_allclose(held.place[told[0]], (0.05 + 0.1 + 8 * 0.45) / 10)


def test_points_beyond_the_map_are_refused_and_leave_it_as_it_was() -> None:
    held = VoxelMap(SIZE)
    held.add(np.zeros((1, 3)), 0, 1, 9, 0.3)
    with pytest.raises(InputError, match="beyond the reach"):
        held.add(np.array([[0.1, 0, 0], [0, SIZE * (FARTHEST + 1.0), 0]]), 1, 1, 9, 0.3)
    assert len(held) == 1
    assert held.count.sum() == 1


@pytest.mark.parametrize("reach", [1, 2])
def test_the_nearest_owner_is_that_of_brute_force(reach: int) -> None:
    rng = np.random.default_rng(3)
    held = VoxelMap(SIZE)
    held.add(rng.uniform(-2, 2, (400, 3)), 0, 1, 9, 0.3)
    slots = np.flatnonzero(held.live)
    held.owner[slots] = np.where(
        rng.uniform(size=len(slots)) < 0.1, rng.integers(0, 5, len(slots)), -1
    )
    found = held.nearest_owner(slots, reach)
    grid = np.floor(held.place[slots] / SIZE)
    distance = cdist(held.place[slots], held.place[slots])
    distance[cdist(grid, grid, "chebyshev") > reach] = np.inf
    distance[:, held.owner[slots] < 0] = np.inf
    best = np.argmin(distance, axis=1)
    expected = np.where(np.isfinite(distance.min(axis=1)), held.owner[slots][best], -1)
    np.testing.assert_array_equal(found, expected)


def node(x: float) -> SceneNode:
    return SceneNode(np.array([x, 0.0, 0.0]), 1.0, 1.0, 0.0, 0.1, 0.1, np.empty(0, np.int64))


def line(count: int) -> SceneGraph:
    graph = SceneGraph(1.0)
    for k in range(count):
        graph.put(k, node(0.5 * k))
    for k in range(count - 1):
        graph.join((k, k + 1), Chain(*(np.empty(s) for s in ((0,), (0, 3), (0,), (0,)))))
    return graph


def test_nodes_are_found_by_place_until_they_go() -> None:
    graph = line(40)
    near = graph.around(np.array([[10.0, 0.2, 0.1]]), 0.6)
    assert {19, 20, 21} <= set(near)
    assert max(near) < 30
    graph.remove(20)
    assert 20 not in graph.around(np.array([[10.0, 0.2, 0.1]]), 0.6)
    assert graph.nodes[19].links == {18}
    assert pair_of(20, 19) not in graph.chains


def test_a_moved_node_is_found_where_it_is() -> None:
    graph = line(3)
    graph.put(1, node(30.0))
    assert 1 in graph.around(np.array([[30.0, 0, 0]]), 0.1)
    assert 1 not in graph.around(np.array([[0.5, 0, 0]]), 0.1)


def test_ways_around_what_is_updated_are_found_nearby_only() -> None:
    """A ring hangs together without one of its nodes; a search that is cut off says it does not."""
    graph = line(30)
    graph.join((0, 29), Chain(*(np.empty(s) for s in ((0,), (0, 3), (0,), (0,)))))
    label = graph.pieces_beyond([9, 11], {10}, 100)
    assert label[9] == label[11]
    label = graph.pieces_beyond([9, 11], {10}, 5)
    assert label[9] != label[11]
    graph.remove(20)
    label = graph.pieces_beyond([9, 11], {10}, 100)
    assert label[9] != label[11]
