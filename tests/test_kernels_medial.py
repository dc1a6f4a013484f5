"""Medial places: what is near in a grid, what a patch says, and where the middle then is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import random_mass, rotation
from scipy import sparse
from scipy.spatial import cKDTree

from mdcs_pipeline.kernels.compiled.grid import grid_of, scattered, share_near, within
from mdcs_pipeline.kernels.compiled.stirred import near_any
from mdcs_pipeline.kernels.compiled.symmetric import principal
from mdcs_pipeline.kernels.compiled.tangent import (
    bends,
    medians_alike,
    patch_planes,
    scatters,
)
from mdcs_pipeline.kernels.compiled.touching import tangent_radii
from mdcs_pipeline.kernels.medial import Medial, MedialRule, Remembered, medial_places, without_gaps
from mdcs_pipeline.kernels.surface import surface_graph

SEEDS = st.integers(0, 100_000)
BOTH = pytest.mark.parametrize("plain", [True, False], ids=["python", "compiled"])
#: Radius of every limb here; the estimate that the kernels are given is a little less.
R = 0.1
GUESS = 0.8 * R
#: Each point has its own ball; where near ones share theirs, whose it is depends on the order.
FINE = MedialRule(coarse=0.0)


# ------------------------------------------------------------------------------------ shapes


def shell(
    count: int, seed: int, first: float = 0.0, last: float = 2 * np.pi, length: float = 1.0
) -> np.ndarray:
    """Return points on a cylinder around x, open at both ends, between two angles."""
    rng = np.random.default_rng(seed)
    angle, x = rng.uniform(first, last, count), rng.uniform(0, length, count)
    return np.stack([x, R * np.cos(angle), R * np.sin(angle)], axis=1)


def sphere(count: int, seed: int) -> np.ndarray:
    drawn = np.random.default_rng(seed).standard_normal((count, 3))
    return R * drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


def clump(name: str, seed: int, count: int) -> np.ndarray:
    """Return points whose neighbours are easily miscounted."""
    rng = np.random.default_rng(seed)
    even = rng.uniform(-1, 1, (count, 3))
    if name == "twins":
        return even[rng.integers(0, max(count // 3, 1), count)]
    if name == "stray":
        return np.concatenate([even, [[1e7, -3e6, 2.0]]])
    if name == "lattice":
        # Distances that equal the reach, and points on the walls of cells.
        return rng.integers(-3, 4, (count, 3)) * 0.5
    return even - 50.0 if name == "negative" else even


def found_on(points: np.ndarray, guess: float = GUESS, **rule: float) -> Medial:
    count = len(points)
    graph = surface_graph(points, 12, 0).graph
    rules = MedialRule()._replace(**rule)
    return medial_places(points, np.full(count, 1 / count), graph, np.full(count, guess), rules)


def off_axis(found: Medial, axis: float = 0.0) -> np.ndarray:
    """Return how far places are from a line along x at y = `axis`, in radii."""
    return np.linalg.norm(found.places[:, 1:] - [axis, 0.0], axis=1) / R


def inner(points: np.ndarray) -> np.ndarray:
    """Return which points are two radii away from the rims of a shell of length 1."""
    return np.abs(points[:, 0] - 0.5) < 0.5 - 2 * R


def is_middle(found: Medial, off: np.ndarray, of: np.ndarray) -> None:
    """Hold places to 0.1 r and radii to 5 %, each with room for a few odd samples."""
    assert np.median(off[of]) < 0.07
    assert np.quantile(off[of], 0.97) < 0.15
    assert np.median(found.radius[of]) == pytest.approx(R, rel=0.06)
    assert (np.abs(found.radius[of] / R - 1) < 0.12).mean() > 0.97
    assert found.trust[of].mean() > 0.97


# -------------------------------------------------------------------------------------- grid


@pytest.mark.parametrize("name", ["even", "twins", "stray", "lattice", "negative"])
@given(
    seed=SEEDS,
    count=st.integers(1, 150),
    size=st.sampled_from([0.0, 1e-3, 0.25, 0.5, 7.0]),
    reach=st.sampled_from([0.0, 0.3, 0.5, 1.5]),
)
@settings(max_examples=30, deadline=None)
def test_within_finds_what_a_tree_finds(name, seed, count, size, reach):
    points = clump(name, seed, count)
    grid = grid_of(points, max(size, reach / 40))
    tree, room = cKDTree(points), np.empty(len(points), np.int64)
    rng = np.random.default_rng(seed)
    for place in [*points[:5], points[0] + rng.normal(0, 0.3, 3), points.min(axis=0) - 9.0]:
        near = room[: within(grid, place, reach, room)]
        assert sorted(grid.order[near]) == sorted(tree.query_ball_point(place, reach))


@given(seed=SEEDS, count=st.integers(0, 60), size=st.sampled_from([0.0, 0.1, 9.0]))
@settings(max_examples=30, deadline=None)
def test_a_grid_is_the_cloud_in_another_order(seed, count, size):
    points = clump("twins", seed, count)
    grid = grid_of(points, size)
    np.testing.assert_array_equal(np.sort(grid.order), np.arange(count))
    np.testing.assert_array_equal(grid.points, points[grid.order])
    np.testing.assert_array_equal(scattered(grid, grid.points), points)
    assert (np.diff(grid.keys) >= 0).all()
    assert grid.size > 0


@given(
    seed=SEEDS,
    count=st.integers(1, 300),
    size=st.sampled_from([1e-4, 0.1, 0.4, 9.0]),
    kind=st.sampled_from([np.float64, np.float32]),
)
@settings(max_examples=40, deadline=None)
def test_a_grid_is_sorted_by_cells_and_then_by_the_clouds_order(seed, count, size, kind):
    """Cells that are counted and cells that are too many for it give one order."""
    points = np.round(np.random.default_rng(seed).uniform(-1, 1, (count, 3)), 1).astype(kind)
    grid = grid_of(points, size)
    cells = np.floor((points.astype(float) - grid.low) / grid.size).astype(np.int64)
    wanted = np.lexsort((np.arange(count), *cells.T[::-1]))
    np.testing.assert_array_equal(grid.order, wanted)
    np.testing.assert_array_equal(grid.shape, cells.max(axis=0) + 1)
    if len(grid.starts):
        named = cells @ [grid.shape[1] * grid.shape[2], grid.shape[2], 1]
        held = np.bincount(named, minlength=len(grid.starts) - 1)
        np.testing.assert_array_equal(np.diff(grid.starts), held)


def test_a_far_point_widens_the_cells_but_not_beyond_counting():
    points = np.array([[0.0, 0, 0], [1e-3, 0, 0], [1e9, 1e9, 1e9]])
    grid, room = grid_of(points, 1e-6), np.empty(3, np.int64)
    assert (grid.keys >= 0).all()
    assert sorted(grid.order[room[: within(grid, points[0], 0.1, room)]]) == [0, 1]
    assert list(grid.order[room[: within(grid, points[2], 1.0, room)]]) == [2]


# ----------------------------------------------------------------------------------- patches


@given(seed=SEEDS, shift=st.sampled_from([0.0, -20.0]))
@settings(max_examples=20, deadline=None)
def test_a_plane_has_its_normal_and_no_height(seed, shift):
    rng, turn = np.random.default_rng(seed), rotation(seed)
    flat = np.column_stack([rng.uniform(-1, 1, (400, 2)), np.zeros(400)])
    grid = grid_of(flat @ turn.T + shift, 0.3)
    mass, reach = random_mass(rng, 400), rng.uniform(0.25, 0.5, 400)
    normals, heights, spreads, widths = patch_planes(grid, mass, reach, 6)
    np.testing.assert_allclose(np.abs(normals @ turn[:, 2]), 1.0, atol=1e-9)
    np.testing.assert_allclose(heights, 0.0, atol=1e-9)
    # A root of round-off, about 1e-16 of the coordinates' square.
    np.testing.assert_allclose(spreads[:, 0], 0.0, atol=1e-6)
    assert (spreads[:, 1] > 1e-3 * reach).all()
    assert (widths >= reach).all()


def test_a_patch_of_too_few_points_grows_until_it_has_them():
    points = np.column_stack([np.arange(40.0), np.arange(40.0) ** 2 % 7, np.zeros(40)])
    grid, mass = grid_of(points, 1.0), np.ones(40)
    *_, widths = patch_planes(grid, mass, np.full(40, 0.5), 2)
    tree = cKDTree(grid.points)
    assert (widths > 0.5).all()
    for place, wide in zip(grid.points, widths, strict=True):
        assert len(tree.query_ball_point(place, wide)) >= 2
        assert len(tree.query_ball_point(place, wide / 1.26)) < 2
    # It does not grow for ever.
    *_, widths = patch_planes(grid, mass, np.full(40, 1e-3), 12)
    assert (widths < 0.01).all()


@given(seed=SEEDS)
@settings(max_examples=15, deadline=None)
def test_a_patch_is_the_same_whichever_others_are_asked_for(seed):
    rng = np.random.default_rng(seed)
    grid, mass = grid_of(rng.uniform(-1, 1, (70, 3)), 0.3), random_mass(rng, 70)
    reach, which = rng.uniform(0.1, 0.6, 70), np.flatnonzero(rng.random(70) < 0.4)
    every = patch_planes(grid, mass, reach, 5)
    some = patch_planes(grid, mass, reach, 5, which)
    for one, other in zip(every, some, strict=True):
        np.testing.assert_array_equal(one[which], other)
    bend = bends(grid, every[0], reach)
    np.testing.assert_array_equal(bends(grid, every[0], reach, which), bend[which])


@given(seed=SEEDS)
@settings(max_examples=15, deadline=None)
def test_what_no_changed_point_is_or_was_near_stays_as_it_was(seed):
    rng = np.random.default_rng(seed)
    before, reach = grid_of(rng.uniform(-1, 1, (200, 3)), 0.3), rng.uniform(0.05, 0.4, 200)
    # Few are compared one by one, more by their cells.
    changed = rng.random(200) < rng.choice([0.02, 0.5])
    moved = before.points + np.where(changed[:, None], rng.normal(0, 0.05, (200, 3)), 0.0)
    grid = before._replace(points=moved)
    touched = near_any(grid, reach, changed, np.arange(200), before.points)
    some = np.flatnonzero(rng.random(200) < 0.5)
    np.testing.assert_array_equal(
        near_any(grid, reach, changed, some, before.points), touched[some]
    )
    assert not near_any(grid, reach, np.zeros(200, bool), some, before.points).any()
    now, then = np.empty(200, np.int64), np.empty(200, np.int64)
    for i in np.flatnonzero(~touched):
        here = now[: within(grid, grid.points[i], reach[i], now)]
        np.testing.assert_array_equal(
            here, then[: within(before, before.points[i], reach[i], then)]
        )
        assert not changed[here].any()


@given(seed=SEEDS)
@settings(max_examples=15, deadline=None)
def test_only_what_is_near_a_changed_point_is_touched(seed):
    """Cells alone would name four times as many, and their patches would be fitted in vain."""
    rng = np.random.default_rng(seed)
    grid, reach = grid_of(rng.uniform(-1, 1, (300, 3)), 0.3), rng.uniform(0.05, 0.4, 300)
    changed = rng.random(300) < rng.choice([0.02, 0.5])
    apart = np.linalg.norm(grid.points[:, None] - grid.points[None], axis=2)
    near = (apart[:, changed] <= reach[:, None]).any(axis=1)
    touched = near_any(grid, reach, changed, np.arange(300), grid.points)
    np.testing.assert_array_equal(touched, near | changed)


def test_a_grid_without_a_table_of_its_cells_finds_the_same():
    near, rng = np.random.default_rng(0).uniform(0, 1, (300, 3)), np.random.default_rng(1)
    # A far point makes cells beyond number.
    points = np.concatenate([near, [[500.0, 500.0, 500.0]]])
    dense, wide = grid_of(near, 0.05), grid_of(points, 0.05)
    assert len(dense.starts)
    assert not len(wide.starts)
    found, others = np.empty(301, np.int64), np.empty(301, np.int64)
    for place, reach in zip(rng.uniform(-0.2, 1.2, (50, 3)), rng.uniform(0, 0.5, 50), strict=True):
        one = dense.order[found[: within(dense, place, reach, found)]]
        other = wide.order[others[: within(wide, place, reach, others)]]
        np.testing.assert_array_equal(one, other)


@given(seed=SEEDS, thin=st.sampled_from([1.0, 1e-4, 0.0]))
@settings(max_examples=30, deadline=None)
def test_eigenvectors_by_rotations_are_those_of_the_library(seed, thin):
    rng, turn = np.random.default_rng(seed), rotation(seed)
    wanted = np.sort(rng.uniform(0.1, 2, 3) * [thin, 1, 1])
    matrix, values, vectors = (turn * wanted) @ turn.T, np.empty(3), np.empty((3, 3))
    whole = 0.5 * (matrix + matrix.T)
    principal(whole.copy(), values, vectors)
    np.testing.assert_allclose(values, wanted, atol=1e-14)
    np.testing.assert_allclose((vectors * values) @ vectors.T, whole, atol=1e-14)
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(values, np.linalg.eigvalsh(whole), atol=1e-14)


def test_heavy_points_hold_the_plane():
    rng = np.random.default_rng(0)
    flat = np.column_stack([rng.uniform(-1, 1, (200, 2)), np.zeros(200)])
    above = np.column_stack([rng.uniform(-1, 1, (200, 2)), np.full(200, 0.2)])
    grid = grid_of(np.concatenate([flat, above]), 1.0)
    mass = np.where(grid.points[:, 2] > 0.1, 1e-9, 1.0)
    normals, heights, *_ = patch_planes(grid, mass, np.full(400, 0.8), 6)
    np.testing.assert_allclose(np.abs(normals[:, 2]), 1.0, atol=1e-6)
    np.testing.assert_allclose(np.abs(heights), np.where(mass < 0.5, 0.2, 0.0), atol=1e-6)


def test_a_ring_bends_away_from_its_outward_normal():
    points = shell(3000, 0)
    grid = grid_of(points, R)
    outward = grid.points * [0.0, 1 / R, 1 / R]
    bend = bends(grid, outward, np.full(len(points), R))
    assert (bend > 0.05).all()
    np.testing.assert_allclose(bends(grid, -outward, np.full(len(points), R)), -bend)


@pytest.mark.parametrize(("pierced", "apart"), [(0, 1.0), (3, 1.4)])
def test_the_largest_ball_in_a_tube_is_as_wide_as_it(pierced, apart):
    points = shell(4000, 1)
    grid = grid_of(points, 0.5 * R)
    outward = grid.points * [0.0, 1 / R, 1 / R]
    found = tangent_radii(grid, outward, np.full(len(points), 5 * R), apart, pierced)
    # No ball is smaller than the tube, and the far wall stops those that are larger.
    deep = inner(grid.points)
    assert found.min() > R * (1 - 1e-9)
    assert found[deep].max() < 1.05 * R
    # On the other side is nothing.
    outside = tangent_radii(grid, -outward, np.full(len(points), 5 * R), apart, pierced)
    np.testing.assert_array_equal(outside, 5 * R)


@given(seed=SEEDS, size=st.sampled_from([0.05, 0.2, 1.0]))
@settings(max_examples=40, deadline=None)
def test_balls_are_those_of_a_search_over_all_points(seed, size):
    rng = np.random.default_rng(seed)
    points, normals = rng.uniform(-1, 1, (60, 3)), sphere(60, seed) / R
    grid, most, apart, pierced = grid_of(points, size), rng.uniform(0.2, 3, 60), 1.2, 2
    found = tangent_radii(grid, normals, most, apart, pierced)
    step = grid.points[None] - grid.points[:, None]
    depth = -np.einsum("ija,ia->ij", step, normals)
    away = np.square(step).sum(axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        radius = np.where(depth > 0, away / (2 * depth), np.inf)
        # Seen from the centre, the point stands at `apart` from where the ball touches.
        radius[np.sqrt(away) <= 2 * radius * np.sin(apart / 2)] = np.inf
    wanted = np.minimum(np.sort(radius, axis=1)[:, pierced], most)
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


def test_medians_take_what_faces_the_same_way():
    rng = np.random.default_rng(0)
    points, values = rng.uniform(-1, 1, (80, 3)), rng.uniform(1, 2, 80)
    grid, normals = grid_of(points, 0.5), sphere(80, 1) / R
    found = medians_alike(grid, normals, np.full(80, 0.6), values, 0.3)
    for i, place in enumerate(grid.points):
        near = np.linalg.norm(grid.points - place, axis=1) <= 0.6
        near &= (normals @ normals[i] > 0.3) | (np.arange(80) == i)
        assert found[i] == pytest.approx(np.median(values[near]))


@BOTH
def test_scatter_is_the_distance_of_places_from_their_own_line(plain):
    run = scatters.py_func if plain else scatters
    rng = np.random.default_rng(0)
    points, places = rng.uniform(-1, 1, (60, 3)), rng.standard_normal((60, 3)) * [3, 0.2, 0.1]
    grid = grid_of(points, 0.5)
    reach = rng.uniform(0.5, 0.9, 60)
    found = run(grid, reach, places)
    told = 0
    for i, place in enumerate(grid.points):
        near = np.linalg.norm(grid.points - place, axis=1) <= reach[i]
        if near.sum() < 4:
            assert found[i] == np.inf
            continue
        told += 1
        spread = np.linalg.svd(places[near] - places[near].mean(axis=0), compute_uv=False)
        wanted = np.sqrt((spread[1] ** 2 + spread[2] ** 2) / near.sum())
        assert found[i] == pytest.approx(wanted, abs=1e-7)
    assert told > 20
    straight = np.outer(np.arange(60.0), [1, 2, 3])
    np.testing.assert_allclose(run(grid, np.full(60, 9.0), straight), 0.0, atol=1e-5)


# ------------------------------------------------------------------------------------ places


@pytest.mark.parametrize("seed", range(3))
def test_a_tube_has_its_middle_on_the_axis(seed):
    points = shell(4000, seed)
    found = found_on(points)
    is_middle(found, off_axis(found), inner(points))
    outward = np.einsum("na,na->n", found.normals, points * [0, 1 / R, 1 / R])
    assert (outward[inner(points)] > 0.9).all()


@pytest.mark.parametrize("seed", range(3))
def test_half_a_tube_has_the_middle_of_the_whole(seed):
    points = shell(4000, seed, 0, np.pi)
    found = found_on(points)
    angle = np.arctan2(points[:, 2], points[:, 1])
    is_middle(found, off_axis(found), inner(points) & (np.abs(angle - np.pi / 2) < 0.9))


def test_a_ball_has_its_middle_in_its_centre():
    points = sphere(4000, 0)
    found = found_on(points)
    off = np.linalg.norm(found.places, axis=1) / R
    is_middle(found, off, np.ones(len(points), bool))
    assert (np.einsum("na,na->n", found.normals, points) > 0.9 * R).all()


def test_two_shells_that_nothing_joins_have_one_middle():
    upper, lower = (shell(2500, k, k * np.pi + 0.5, (k + 1) * np.pi - 0.5) for k in (0, 1))
    points = np.concatenate([upper, lower])
    found = found_on(points)
    angle = np.abs(np.arctan2(points[:, 2], points[:, 1]))
    is_middle(found, off_axis(found), inner(points) & (np.abs(angle - np.pi / 2) < 0.5))
    # Even at the cuts it is nearer than half way.
    assert off_axis(found)[inner(points)].max() < 0.5


def side_by_side(gap: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return two parallel tubes, and y of the axis that each point belongs to."""
    apart = 2 * R + gap
    points = np.concatenate([shell(3000, seed), shell(3000, seed + 1) + np.array([0, apart, 0])])
    return points, np.repeat([0.0, apart], 3000)


def all_links(points: np.ndarray, reach: float) -> sparse.csr_array:
    """Return the graph of all points within reach of each other."""
    i, j = cKDTree(points).query_pairs(reach, output_type="ndarray").T
    length = np.linalg.norm(points[i] - points[j], axis=1)
    half = sparse.coo_array((length, (i, j)), (len(points), len(points)))
    return sparse.csr_array(half + half.T)


def test_tubes_beside_each_other_keep_their_own_middles():
    points, axis = side_by_side(R)
    found = found_on(points)
    off = np.linalg.norm(found.places[:, 1:] - np.stack([axis, 0 * axis], 1), axis=1) / R
    is_middle(found, off, inner(points))
    graph = all_links(points, 1.3 * R)
    cut = sparse.coo_array(without_gaps(graph, points, found, 0.5))
    whole = sparse.coo_array(graph)
    along = axis[whole.row] == axis[whole.col]
    assert (~along).sum() > 1000
    left = axis[cut.row] == axis[cut.col]
    assert (~left).sum() < 0.01 * (~along).sum()
    # All that is along a tube is left, in the order in which it was.
    np.testing.assert_array_equal(cut.row[left], whole.row[along])
    np.testing.assert_array_equal(cut.col[left], whole.col[along])
    np.testing.assert_array_equal(cut.data[left], whole.data[along])


def test_links_between_points_that_are_not_sure_stay():
    points, _ = side_by_side(R)
    found = found_on(points)
    graph = all_links(points, 1.3 * R)
    doubtful = found._replace(trust=np.zeros(len(points)))
    assert without_gaps(graph, points, doubtful, 0.5).nnz == graph.nnz
    assert without_gaps(graph, points, found, 1e9).nnz == graph.nnz


def test_rough_points_stay_where_they_are():
    points = shell(3000, 0) + 0.5 * R * np.random.default_rng(1).standard_normal((3000, 3))
    found = found_on(points, R)
    # Some places of so many agree by chance.
    stay = found.trust == 0.0
    assert stay.mean() > 0.9
    np.testing.assert_array_equal(found.places[stay], points[stay])
    np.testing.assert_array_equal(found.radius[stay], R)


def test_a_patch_around_a_thin_limb_is_believed_if_its_places_agree():
    """Seven points to a patch: it reaches half around the limb, and yet has a normal."""
    points = shell(300, 0)
    found = found_on(points)
    far = off_axis(found)[inner(points)]
    sure = found.trust[inner(points)] == 1.0
    assert sure.mean() > 0.5
    assert np.median(far[sure]) < 0.15
    assert np.quantile(far[sure], 0.95) < 0.4


@pytest.mark.parametrize("seed", range(6))
def test_hardly_a_place_off_a_sparse_limb_is_believed(seed):
    """A patch of too large a radius grows around the limb, and its few places agree by chance."""
    points = shell(100, seed)
    found = found_on(points, 1.6 * R)
    assert np.mean((off_axis(found) > 0.5) & (found.trust > 0.5)) < 0.08


def off_their_twigs(seed: int) -> float:
    """Return the share of places two radii and more off, of twelve twigs in the air."""
    rng = np.random.default_rng(seed)
    points, ways = [], []
    for _ in range(12):
        middle, axes = rng.uniform(-2.0, 2.0, 3), rotation(int(rng.integers(1 << 30)))
        tube = shell(42, int(rng.integers(1 << 30)), length=3.0) - [1.5, 0.0, 0.0]
        points.append(middle + tube @ axes)
        ways.append(np.tile([*middle, *axes[0]], (42, 1)))
    places = found_on(np.concatenate(points), 2 * R).places
    middle, axis = np.split(np.concatenate(ways), 2, axis=1)
    offset = places - middle
    off = offset - (offset * axis).sum(axis=1, keepdims=True) * axis
    return float(np.mean(np.linalg.norm(off, axis=1) > 2 * R))


def test_few_places_in_the_air_between_sparse_twigs_are_believed():
    """First radii are twice too large. Where only a patch had to agree it were 7 in 100."""
    assert np.mean([off_their_twigs(seed) for seed in range(12)]) < 0.04


def test_a_little_noise_leaves_the_middle_where_it_is():
    points = shell(4000, 0)
    noisy = points + 0.1 * R * np.random.default_rng(1).standard_normal(points.shape)
    found = found_on(noisy)
    is_middle(found, off_axis(found), inner(points))


@given(seed=SEEDS, reach=st.sampled_from([0.0, 0.3, 5.0]))
@settings(max_examples=15, deadline=None)
def test_shares_are_those_of_a_count(seed, reach):
    rng = np.random.default_rng(seed)
    points, places = rng.uniform(-1, 1, (90, 3)), rng.uniform(-1.5, 1.5, (20, 3))
    some = rng.random(90) < 0.3
    grid = grid_of(points, 0.3)
    found = share_near(grid, some[grid.order], places, np.full(20, reach))
    near = np.linalg.norm(places[:, None] - points, axis=2) <= reach
    count = (near & some).sum(axis=1) / np.maximum(near.sum(axis=1), 1)
    np.testing.assert_allclose(found, count)


# ------------------------------------------------------------------------------ remembered


def measured_where(asked: np.ndarray, points: np.ndarray, **rule: float) -> tuple[Medial, Medial]:
    """Return what is found for all points, and with that known but for those asked for."""
    count = len(points)
    given = points, np.full(count, 1 / count), surface_graph(points, 12, 0).graph
    whole = medial_places(*given, np.full(count, GUESS), MedialRule()._replace(**rule))
    # What is asked for must not be looked up.
    hidden = (np.where(asked if v.ndim == 1 else asked[:, None], 0.0, v) for v in whole)
    known = Remembered(asked, Medial(*hidden))
    guess = np.where(asked, GUESS, whole.radius)
    return whole, medial_places(*given, guess, MedialRule()._replace(**rule), known)


@pytest.mark.parametrize("coarse", [0.0, 0.15])
def test_what_is_known_stays_and_what_is_asked_for_is_found_beside_it(coarse):
    rng = np.random.default_rng(4)
    points = shell(2000, 3) + rng.normal(0, 0.05 * R, (2000, 3))
    asked = points[:, 0] < 0.4
    whole, found = measured_where(asked, points, coarse=coarse)
    for known, kept in zip(whole, found, strict=True):
        np.testing.assert_array_equal(kept[~asked], known[~asked])
    there = asked & inner(points)
    off, usual = off_axis(found)[there], off_axis(whole)[there]
    assert np.quantile(off, 0.97) < np.quantile(usual, 0.97) + 0.02
    assert np.median(off) < 0.07
    assert np.median(found.radius[there]) == pytest.approx(R, rel=0.06)
    assert found.trust[there].mean() > 0.97
    facing = np.einsum("na,na->n", found.normals, points * [0, 1, 1])[asked]
    assert (facing > 0).mean() > 0.98


def test_asked_for_all_of_it_nothing_is_looked_up():
    points = shell(900, 5)
    whole, found = measured_where(np.ones(900, bool), points)
    for one, other in zip(whole, found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_asked_for_nothing_all_is_looked_up():
    points = shell(900, 5)
    whole, found = measured_where(np.zeros(900, bool), points)
    for one, other in zip(whole, found, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_known_says_where_outside_is(seed):
    """A lone strip of a tube cannot tell; beside a known shell it faces the way that one does."""
    points = shell(1600, seed)
    asked = (points[:, 1] > 0.8 * R) & (np.abs(points[:, 0] - 0.5) < 0.3)
    _, found = measured_where(asked, points)
    assert asked.sum() > 30
    assert (found.normals[asked, 1] > 0).mean() > 0.95


# -------------------------------------------------------------------------------- invariance


def moved(
    points: np.ndarray, turn: np.ndarray, shift: float, scale: float, order: np.ndarray
) -> tuple[Medial, Medial]:
    """Return what is found for a cloud with uneven masses and radii, and where it was moved to."""
    rng = np.random.default_rng(7)
    mass, guess = random_mass(rng, len(points)), GUESS * rng.uniform(0.95, 1.05, len(points))
    graph = surface_graph(points, 12, 0).graph
    one = medial_places(points, mass, graph, guess, FINE)
    there = ((points @ turn.T + shift) * scale)[order]
    links = sparse.csr_array((graph * scale)[order][:, order])
    return one, medial_places(there, mass[order], links, scale * guess[order], FINE)


@pytest.mark.parametrize("seed", range(3))
def test_places_move_with_the_cloud(seed):
    beside = shell(1200, seed + 9) + np.array([0, 3.2 * R, 0])
    points = np.concatenate([shell(1200, seed), beside])
    turn, shift, scale = rotation(seed), [0.0, 2.0, -5.0][seed], [1.0, 1e-3, 40.0][seed]
    order = np.random.default_rng(seed).permutation(len(points))
    one, other = moved(points, turn, shift, scale, order)
    where = (one.places @ turn.T + shift) * scale
    np.testing.assert_allclose(other.places, where[order], rtol=0, atol=1e-9 * scale)
    np.testing.assert_allclose(other.radius, scale * one.radius[order], rtol=1e-9)
    np.testing.assert_allclose(other.normals, (one.normals @ turn.T)[order], atol=1e-9)
    np.testing.assert_allclose(other.trust, one.trust[order], atol=1e-9)


def test_a_power_of_two_changes_no_bit():
    points, order = shell(1500, 0), np.arange(1500)
    one, other = moved(points, np.eye(3), 0.0, 8.0, order)
    np.testing.assert_array_equal(other.places, 8.0 * one.places)
    np.testing.assert_array_equal(other.radius, 8.0 * one.radius)


def test_the_order_of_the_points_does_not_matter():
    points, order = shell(1500, 0), np.random.default_rng(0).permutation(1500)
    one, other = moved(points, np.eye(3), 0.0, 1.0, order)
    for kept, mixed in zip(one, other, strict=True):
        np.testing.assert_allclose(mixed, kept[order], rtol=0, atol=1e-12)


def test_places_of_the_default_rule_move_by_little_with_the_order():
    points, order = shell(1500, 0), np.random.default_rng(0).permutation(1500)
    one, other = found_on(points), found_on(points[order])
    off = np.linalg.norm(other.places - one.places[order], axis=1) / R
    assert np.median(off) < 0.1
    np.testing.assert_allclose(np.median(other.radius), np.median(one.radius), rtol=0.01)


# -------------------------------------------------------------------------------- degenerate


@pytest.mark.parametrize(
    "points",
    [
        np.empty((0, 3)),
        np.array([[1.0, -2, 3]]),
        np.array([[0.0, 0, 0], [1, 0, 0]]),
        np.full((20, 3), -4.0),
        np.linspace([0.0, 0, 0], [1, 2, 3], 50),
        np.eye(3),
        np.stack(np.meshgrid(*[np.arange(9.0)] * 2, [0.0]), -1).reshape(-1, 3),
        np.concatenate([np.full((30, 3), 0.5), np.eye(3)]),
    ],
    ids=["none", "one", "two", "same", "line", "simplex", "plane", "clump"],
)
@pytest.mark.filterwarnings("error")
def test_clouds_without_a_surface_give_finite_places(points):
    count = len(points)
    links = sparse.csr_array(np.ones((count, count)) - np.eye(count))
    mass, guess = np.full(count, 1 / max(count, 1)), np.full(count, 0.3)
    before = points.copy()
    found = medial_places(points, mass, links, guess, MedialRule())
    assert found.places.shape == found.normals.shape == (count, 3)
    assert found.radius.shape == found.trust.shape == (count,)
    assert all(np.isfinite(values).all() for values in found)
    assert (found.radius > 0).all()
    assert ((found.trust >= 0) & (found.trust <= 1)).all()
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, atol=1e-9)
    assert without_gaps(links, points, found, 0.5).shape == links.shape
    np.testing.assert_array_equal(points, before)


def test_points_without_links_are_found_too():
    points = shell(800, 0)
    alone = sparse.csr_array((800, 800))
    found = medial_places(points, np.full(800, 1 / 800), alone, np.full(800, GUESS), MedialRule())
    assert all(np.isfinite(values).all() for values in found)
    assert (np.einsum("na,na->n", found.normals, points * [0, 1, 1]) > 0).mean() > 0.9
