"""Frames, voxels, density, outliers, surface graph and thickness of clouds."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import line, random_mass, rotation, torus, tube, two_bars, y_shape
from scipy import sparse
from scipy.spatial.distance import cdist

from mdcs_pipeline.kernels import thickness
from mdcs_pipeline.kernels.canonical import canonical_frame
from mdcs_pipeline.kernels.coarsening import coarsened
from mdcs_pipeline.kernels.compiled.farthest import farthest_points
from mdcs_pipeline.kernels.compiled.heap import heap_drop, heap_push
from mdcs_pipeline.kernels.compiled.linking import between_groups, both_ways
from mdcs_pipeline.kernels.compiled.patches import (
    WIDER,
    closing_patches,
)
from mdcs_pipeline.kernels.compiled.selecting import FEW, LANES, median_of, ranks_of, select
from mdcs_pipeline.kernels.compiled.spreading import spread_minimum
from mdcs_pipeline.kernels.compiled.symmetric import middle_eigenvalue
from mdcs_pipeline.kernels.density import area_mass, neighbour_radius
from mdcs_pipeline.kernels.nearest import nearest
from mdcs_pipeline.kernels.outliers import lonely_points, roundness
from mdcs_pipeline.kernels.seeding import random_points, spread_points
from mdcs_pipeline.kernels.surface import averaged, islands, normals, principal_axes, surface_graph
from mdcs_pipeline.kernels.thickness import local_radius
from mdcs_pipeline.kernels.voxels import MAX_CELLS, voxel_means

SEEDS = st.integers(0, 100_000)
BOTH = pytest.mark.parametrize("plain", [True, False], ids=["python", "compiled"])


def lopsided(seed: int = 0, n: int = 200) -> np.ndarray:
    """A cloud with three different widths, each skewed: its frame is well defined."""
    rng = np.random.default_rng(seed)
    return rng.exponential(1.0, (n, 3)) * [3.0, 2.0, 1.0]


def canonical(points: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    frame = canonical_frame(points, weights)
    return (points - frame.centre) @ frame.axes.T / frame.length


# -------------------------------------------------------------------------- canonical frame


@given(seed=SEEDS, shift=st.sampled_from([0.0, 1.0, 1e6]), power=st.integers(-9, 9))
@settings(max_examples=40, deadline=None)
def test_the_frame_moves_with_the_cloud(seed, shift, power):
    points = lopsided()
    weights = random_mass(np.random.default_rng(1), len(points))
    order = np.random.default_rng(seed).permutation(len(points))
    turn, scale = rotation(seed), 10.0**power
    for w in (None, weights):
        moved = ((points @ turn.T + shift) * scale)[order]
        frame = canonical_frame(points, w)
        other = canonical_frame(moved, w if w is None else w[order])
        assert np.linalg.det(other.axes) == pytest.approx(1.0)
        np.testing.assert_allclose(other.axes @ other.axes.T, np.eye(3), atol=1e-12)
        assert other.length == pytest.approx(scale * frame.length, rel=1e-9)
        # What is left is the round-off of coordinates around the shift.
        room = 1e-12 + 1e-15 * shift
        np.testing.assert_allclose(
            other.centre / scale, frame.centre @ turn.T + shift, rtol=0, atol=1e2 * room
        )
        np.testing.assert_allclose(
            canonical(moved, w if w is None else w[order]), canonical(points, w)[order],
            rtol=0, atol=1e3 * room,
        )  # fmt: skip


def test_the_length_is_the_diagonal_of_the_even_box():
    grid = np.stack(np.meshgrid(*[np.arange(20) + 0.5] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    found = canonical_frame(grid * [1.0, 2.0, 3.0], None)
    assert found.length == pytest.approx(20 * np.sqrt(14), rel=2e-3)
    np.testing.assert_allclose(found.centre, [10, 20, 30])


def test_axes_are_ordered_by_spread_and_point_to_the_tail():
    points = lopsided(3, 5000)
    frame = canonical_frame(points, None)
    local = (points - frame.centre) @ frame.axes.T
    assert (np.diff(local.std(axis=0)) < 0).all()
    skew = (local**3).mean(axis=0)
    # The handedness may cost one axis its direction: the one with the least skew.
    assert (skew[np.argsort(np.abs(skew))[1:]] > 0).all()


def test_equal_weights_are_none_and_heavy_points_are_many():
    points = lopsided(1, 50)
    plain, weighed = canonical_frame(points, None), canonical_frame(points, np.full(50, 7.0))
    for one, other in zip(plain, weighed, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)
    times = np.random.default_rng(0).integers(1, 4, 50)
    many = canonical_frame(np.repeat(points, times, axis=0), None)
    for one, other in zip(canonical_frame(points, times.astype(float)), many, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    "points",
    [
        np.full((5, 3), 1e6),
        np.array([[1.0, 2, 3]]),
        np.array([[0.0, 0, 0], [1, 1, 1]]),
        np.linspace([0.0, 0, 0], [1, 2, 3], 10),
        np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]),
        np.eye(3),
    ],
    ids=["same", "one", "two", "line", "square", "simplex"],
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_degenerate_clouds_have_a_right_handed_frame(points, dtype):
    frame = canonical_frame(points.astype(dtype), None)
    assert np.linalg.det(frame.axes) == pytest.approx(1.0)
    np.testing.assert_allclose(frame.axes @ frame.axes.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(frame.centre, points.mean(axis=0), rtol=1e-6)
    spread = np.square(points - points.mean(axis=0)).sum(axis=1).mean()
    assert frame.length == pytest.approx(np.sqrt(12 * spread), rel=1e-5, abs=1e-12)


# ------------------------------------------------------------------------------------ voxels


@given(seed=SEEDS, size=st.floats(0.05, 3.0), weighted=st.booleans())
@settings(max_examples=30, deadline=None)
def test_voxels_hold_the_mass_and_the_centroid_of_their_points(seed, size, weighted):
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 1, (60, 3))
    weights = rng.uniform(0.5, 2, 60) if weighted else None
    w = np.ones(60) if weights is None else weights
    found = voxel_means(points, weights, size)
    cells = np.floor(points / size + 0.5)
    unique = np.unique(cells, axis=0)
    assert len(found.centroids) == len(unique)
    for cell, centroid, weight in zip(unique, found.centroids, found.weights, strict=True):
        inside = (cells == cell).all(axis=1)
        assert weight == pytest.approx(w[inside].sum())
        np.testing.assert_allclose(centroid, np.average(points[inside], 0, w[inside]), atol=1e-14)
    assert found.weights.sum() == pytest.approx(w.sum())
    order = rng.permutation(60)
    again = voxel_means(points[order], None if weights is None else weights[order], size)
    np.testing.assert_allclose(again.centroids, found.centroids, atol=1e-14)
    np.testing.assert_allclose(again.weights, found.weights)


def test_a_cloud_of_too_many_voxels_is_refused_and_the_largest_is_not():
    edge = float(MAX_CELLS)
    points = np.array([[-edge, edge, 0.5], [edge, -edge, -edge]])
    found = voxel_means(points, None, 1.0)
    np.testing.assert_array_equal(found.centroids, points)
    with pytest.raises(ValueError, match="voxels"):
        voxel_means(points + 2.0, None, 1.0)


def test_no_points_fill_no_voxels():
    found = voxel_means(np.empty((0, 3)), None, 1.0)
    assert found.centroids.shape == (0, 3)
    assert found.weights.shape == (0,)


# ---------------------------------------------------------------------- neighbours, density


@given(seed=SEEDS, count=st.integers(1, 12))
@settings(max_examples=20, deadline=None)
def test_neighbours_are_those_of_brute_force(seed, count):
    points = np.random.default_rng(seed).uniform(0, 1, (40, 3))
    distance = cdist(points, points)
    np.fill_diagonal(distance, np.inf)
    found = nearest(points, count)
    np.testing.assert_array_equal(found.indices, np.argsort(distance, axis=1)[:, :count])
    np.testing.assert_allclose(found.distance, np.sort(distance, axis=1)[:, :count], rtol=1e-12)
    np.testing.assert_allclose(neighbour_radius(points, count), found.distance[:, -1])


def test_a_point_is_no_neighbour_of_itself_where_points_coincide():
    """The query's first answer was taken for the point itself; its twin can come first.

    Points in general position, as in the other tests, never show this.
    """
    points = np.repeat([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]], [3, 2, 1], axis=0)
    for count in (1, 2, 5):
        found = nearest(points, count)
        assert not (found.indices == np.arange(6)[:, None]).any()
        assert all(len(set(row)) == count for row in found.indices.tolist())
        exact = np.linalg.norm(points[:, None] - points[found.indices], axis=2)
        np.testing.assert_allclose(found.distance, exact)
    assert surface_graph(points, 2, 0).graph.diagonal().sum() == 0.0


def _crowds(seed: int) -> dict[str, np.ndarray]:
    """Clouds that no one size of cell fits."""
    rng = np.random.default_rng(seed)
    ball = rng.normal(size=(700, 3))
    return {
        "surface": ball / np.linalg.norm(ball, axis=1, keepdims=True),
        "a crowd and some far away": np.concatenate([1e-3 * ball, 30.0 * ball[:40]]),
        "more in a cell than are looked through": np.concatenate(
            [1e-6 * rng.normal(size=(2600, 3)), ball]
        ),
        "outliers beyond counting": np.concatenate([ball, 1e9 * ball[:3]]),
        "twice the same": np.repeat(ball, 2, axis=0),
        "mostly one place": np.concatenate([np.zeros((600, 3)), ball]),
        "a line": np.outer(np.arange(800.0), [1.0, 2.0, 3.0]),
    }


@pytest.mark.parametrize("name", list(_crowds(0)))
@pytest.mark.parametrize("count", [1, 8, 16, 100])
def test_neighbours_by_cells_are_those_of_brute_force_however_points_crowd(name, count):
    """Clouds of a few points are left to a tree: smaller ones would not see the cells."""
    points = _crowds(1)[name]
    found = nearest(points, count)
    apart = cdist(points, points)
    np.fill_diagonal(apart, np.inf)
    np.testing.assert_allclose(
        found.distance, np.sort(apart, axis=1)[:, :count], rtol=1e-6, atol=1e-12
    )
    named = np.take_along_axis(apart, found.indices, axis=1)
    np.testing.assert_allclose(named, found.distance, rtol=1e-6, atol=1e-12)
    assert all(len(set(row)) == count for row in found.indices.tolist())


@BOTH
@given(seed=SEEDS, count=st.integers(1, FEW + 20))
@settings(max_examples=15, deadline=None)
def test_ranks_medians_and_selections_are_those_of_sorting(plain, seed, count):
    """Both ways to a median are taken, and keys are equal now and then."""
    keys = np.random.default_rng(seed).integers(0, 30, count).astype(float)
    room, ranks = np.concatenate([keys, np.zeros(LANES)]), np.empty(count + LANES, np.int64)
    (ranks_of.py_func if plain else ranks_of)(room, count, ranks)
    np.testing.assert_array_equal(ranks[:count], np.argsort(np.argsort(keys, kind="stable")))
    assert (median_of.py_func if plain else median_of)(room, count, ranks) == np.median(keys)
    order, held, middle = np.arange(count), keys.copy(), count // 3
    (select.py_func if plain else select)(held, 0, count, middle, order)
    np.testing.assert_array_equal(held, keys[order])
    assert held[middle] == np.sort(keys)[middle]
    assert held[:middle].max(initial=-1.0) <= held[middle] <= held[middle:].min()


def test_fewer_points_have_fewer_neighbours():
    assert nearest(np.eye(3), 8).indices.shape == (3, 2)
    assert nearest(np.zeros((1, 3)), 8).indices.shape == (1, 0)
    np.testing.assert_allclose(neighbour_radius(np.eye(3), 8), np.sqrt(2))


def test_mass_is_the_square_of_the_radius_between_its_caps():
    radius = np.array([1.0, 1.0, 2.0, 0.5, 100.0, 0.0])
    mass = area_mass(radius, 3.0)
    wanted = np.array([1.0, 1.0, 4.0, 0.25, 9.0, 0.05**2])
    np.testing.assert_allclose(mass, wanted / wanted.sum())
    np.testing.assert_allclose(area_mass(7.0 * radius, 3.0), mass)
    np.testing.assert_allclose(area_mass(np.array([0.0, 0, 0, 5]), 3.0), 0.25)


def test_mass_levels_uneven_sampling():
    rng = np.random.default_rng(0)
    count = np.array([4000, 1000])
    sides = [np.column_stack([rng.uniform(0, 1, (n, 2)), np.zeros(n)]) for n in count]
    sides[1][:, 0] += 1.0
    mass = area_mass(neighbour_radius(np.concatenate(sides), 8), 3.0)
    # The halves have equal areas; four fifths of the points are on one.
    assert mass[:4000].sum() == pytest.approx(0.5, abs=0.03)


# ---------------------------------------------------------------------------------- outliers


def lonely(points, near=2.5, sparse=2.0, far=4.0, round_from=0.1):
    return lonely_points(points, nearest(points, 8), near, sparse, far, round_from)


def test_outliers_are_lonely_and_a_surface_is_not():
    shape = torus(2000)
    rng = np.random.default_rng(0)
    strays = rng.uniform(-0.7, 0.7, (40, 3))
    away = np.abs(np.hypot(np.hypot(strays[:, 0], strays[:, 1]) - 0.5, strays[:, 2]) - 0.12) > 0.1
    found = lonely(np.concatenate([shape.points, strays[away]]))
    assert found[2000:].mean() > 0.9
    assert found[:2000].mean() < 0.02


def test_each_threshold_alone_tells_its_own_points():
    shape = torus(2000)
    points = np.concatenate([shape.points, [[0.0, 0, 0.2]]])
    never = 1e9
    assert np.flatnonzero(lonely(points, never, never, 4.0)).tolist() == [2000]
    assert lonely(points, 2.5, never, never)[2000]
    assert not lonely(points, never, never, never).any()
    # A blob of a few points far from each other, on no surface: round neighbourhoods.
    blob = np.random.default_rng(1).uniform(2, 3, (40, 3))
    both = np.concatenate([shape.points, blob])
    found = lonely(both, never, 2.0, never)
    assert found[2000:].mean() > 0.6
    assert found[:2000].mean() < 0.02


def test_a_sparse_part_of_a_surface_is_kept():
    """Seven times fewer points make a radius 2.6 times as large, which alone tells nothing."""
    rng = np.random.default_rng(0)
    flat = [np.column_stack([rng.uniform(0, 1, (n, 2)), np.zeros(n)]) for n in (3500, 500)]
    flat[1][:, 0] += 1.0
    found = lonely(np.concatenate(flat))
    assert found.mean() < 0.01


def test_roundness_is_the_ratio_of_variances():
    rng = np.random.default_rng(0)
    flat = np.column_stack([rng.uniform(0, 1, (300, 2)), np.zeros(300)])
    ball = rng.standard_normal((300, 3))
    for points, low, high in ((flat, -1e-12, 1e-12), (ball, 0.05, 0.5)):
        value = np.median(roundness(points, nearest(points, 12).indices))
        assert low <= value <= high
    points, indices = rng.uniform(0, 1, (30, 3)), nearest(rng.uniform(0, 1, (30, 3)), 6).indices
    values = [np.linalg.eigvalsh(np.cov(points[row].T)) for row in indices]
    np.testing.assert_allclose(roundness(points, indices), [v[0] / v[2] for v in values])


# ------------------------------------------------------------------------------ surface graph


@given(seed=SEEDS, neighbours=st.integers(1, 8))
@settings(max_examples=20, deadline=None)
def test_the_surface_graph_links_neighbours_both_ways(seed, neighbours):
    points = np.random.default_rng(seed).uniform(0, 1, (40, 3))
    distance = cdist(points, points)
    np.fill_diagonal(distance, np.inf)
    one_way = np.zeros((40, 40))
    rows = np.repeat(np.arange(40), neighbours)
    columns = np.argsort(distance, axis=1)[:, :neighbours].ravel()
    one_way[rows, columns] = distance[rows, columns]
    found = surface_graph(points, neighbours, 0)
    np.testing.assert_allclose(found.graph.toarray(), np.maximum(one_way, one_way.T))
    np.testing.assert_array_equal(found.positions, points)
    assert found.positions is not points


def test_averaging_takes_noise_off_a_plane():
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(0, 1, (1000, 2)), rng.normal(0, 0.01, 1000)])
    placed = averaged(points, 10)
    near = nearest(points, 10).indices
    wanted = [points[[j, *near[j]]].mean(axis=0) for j in range(1000)]
    np.testing.assert_allclose(placed, wanted)
    assert placed[:, 2].std() < 0.5 * points[:, 2].std()
    np.testing.assert_array_equal(surface_graph(points, 8, 10).positions, placed)


def test_normals_are_across_the_surface():
    shape = torus(3000)
    found = normals(shape.points, nearest(shape.points, 10).indices)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0)
    flat = shape.points * [1, 1, 0]
    ring = 0.5 * flat / np.linalg.norm(flat, axis=1, keepdims=True)
    outward = (shape.points - ring) / np.linalg.norm(shape.points - ring, axis=1, keepdims=True)
    assert np.median(np.abs((found * outward).sum(axis=1))) > 0.97


def test_steep_links_do_not_cross_a_gap_narrower_than_the_spacing():
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(np.arange(25.0), np.arange(25.0)), axis=-1).reshape(-1, 2)
    walls = [grid + rng.uniform(-0.2, 0.2, grid.shape) for _ in range(2)]
    walls = [np.column_stack([wall, np.full(625, 1.3 * k)]) for k, wall in enumerate(walls)]
    points = np.concatenate(walls)

    across = []
    for upright in (0.0, 45.0, 60.0, 75.0):
        steepest = np.cos(np.radians(upright))
        graph = surface_graph(points, 8, 0, upright).graph
        np.testing.assert_array_equal(graph.toarray(), graph.toarray().T)
        across.append(graph[:625][:, 625:].nnz)
        # Steep at both ends is what is left out.
        normal = normals(points, nearest(points, 16).indices)
        a, b = graph.nonzero()
        step = (points[b] - points[a]) / np.linalg.norm(points[b] - points[a], axis=1)[:, None]
        both = np.minimum(*(np.abs((step * normal[end]).sum(axis=1)) for end in (a, b)))
        assert both.max() <= steepest + 1e-12
    assert across == sorted(across, reverse=True)
    assert across[0] > 1000
    assert across[2] < 0.2 * across[0]


def test_points_that_coincide_are_still_linked():
    points = np.repeat(np.eye(3), 2, axis=0)
    graph = surface_graph(points, 1, 0).graph
    assert graph.nnz == 6
    assert (graph.data > 0).all()


def test_islands_are_the_parts_with_little_mass():
    shape = two_bars(1000)
    points = np.concatenate([shape.points, np.random.default_rng(0).normal(5, 0.1, (12, 3))])
    near = nearest(points, 6).indices
    mass = np.ones(len(points))
    assert np.flatnonzero(islands(near, mass, 0.02)).tolist() == list(range(1000, 1012))
    assert not islands(near, mass, 0.01).any()
    mass[1000:] = 1000.0
    assert not islands(near, mass, 0.02)[1000:].any()
    assert islands(near, mass, 0.3)[:1000].all()


# ---------------------------------------------------------------------------------- thickness


def radius_of(points: np.ndarray, landmarks: int | None = None, seed: int = 0):
    """The local radius; by default every point is a landmark, so that none is carried far."""
    graph = surface_graph(points, 8, 0).graph
    mass = np.full(len(points), 1 / len(points))
    return local_radius(points, mass, graph, landmarks or len(points), 0.06, 0.6, seed)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("radius", [0.05, 0.1, 0.15])
def test_a_cylinder_has_its_radius(radius, seed):
    shape = line(3000, radius=radius, seed=seed)
    found = radius_of(shape.points, seed=seed)
    middle = np.abs(shape.points[:, 0] - 0.5) < 0.3
    # A patch that has just closed at γ = 0.06 has √(2 λ2) = 1.04 r.
    assert np.median(found.radius[middle]) == pytest.approx(1.04 * radius, rel=0.04)
    assert np.quantile(np.abs(found.radius[middle] / radius - 1), 0.9) < 0.15
    assert (found.confidence == 1).mean() > 0.5
    assert (found.confidence > 0).all()
    assert (found.confidence <= 1).all()


def test_a_radius_carried_from_a_landmark_is_larger_by_the_slope_at_most():
    """With few landmarks the radius is high by about slope times the way to the nearest one."""
    shape = line(3000)
    every, few = (radius_of(shape.points, count) for count in (3000, 400))
    middle = np.abs(shape.points[:, 0] - 0.5) < 0.3
    assert np.median(few.radius[middle]) == pytest.approx(0.1, rel=0.2)
    assert few.confidence.mean() < every.confidence.mean()
    marks = spread_points(shape.points, 400, 0)
    graph = surface_graph(shape.points, 8, 0).graph
    way = sparse.csgraph.dijkstra(graph, indices=marks).min(axis=0)
    # Medians over other landmarks differ a little from those over all points.
    assert (few.radius <= 1.1 * every.radius.max() + 0.6 * way).all()


def test_a_torus_has_the_radius_of_its_tube():
    assert np.median(radius_of(torus(3000).points).radius) == pytest.approx(0.12, rel=0.15)


def test_a_cone_grows():
    rng = np.random.default_rng(0)
    share = np.sqrt(rng.uniform(0.05**2, 0.16**2, 4000))
    angle = rng.uniform(0, 2 * np.pi, 4000)
    x = (share - 0.05) / 0.11
    points = np.column_stack([x, share * np.cos(angle), share * np.sin(angle)])
    found = radius_of(points).radius
    parts = ((0.1, 0.35), (0.4, 0.6), (0.65, 0.9))
    thirds = [np.median(found[(x >= a) & (x < b)]) for a, b in parts]
    assert thirds[0] < thirds[1] < thirds[2]
    np.testing.assert_allclose(thirds, 0.05 + 0.11 * np.array([0.225, 0.5, 0.775]), rtol=0.25)


def test_a_sheet_is_thick_away_from_its_corners():
    """In a corner most of the patch is missing, and it closes at once."""
    rng = np.random.default_rng(0)
    sheet = np.column_stack([rng.uniform(0, 1, (2000, 2)), np.zeros(2000)])
    centre = np.abs(sheet[:, :2] - 0.5).max(axis=1) < 0.15
    assert radius_of(sheet).radius[centre].min() > 0.2


def test_a_part_without_a_landmark_is_given_the_median_without_confidence():
    shape = line(1500)
    speck = np.random.default_rng(0).normal(5, 0.01, (12, 3))
    points = np.concatenate([shape.points, speck])
    graph = surface_graph(points, 8, 0).graph
    first = np.random.default_rng(0).integers(len(points))
    assert first < 1500, "the one landmark lies on the line"
    found = local_radius(points, np.full(1512, 1 / 1512), graph, 1, 0.06, 0.6, 0)
    np.testing.assert_array_equal(np.flatnonzero(found.confidence == 0), np.arange(1500, 1512))
    np.testing.assert_allclose(found.radius[1500:], found.radius[first])


def test_a_line_of_points_still_has_a_radius():
    points = np.linspace([0.0, 0, 0], [1, 0, 0], 101)
    spacing = np.median(surface_graph(points, 8, 0).graph.data)
    np.testing.assert_allclose(radius_of(points).radius, spacing)


def test_the_radius_grows_by_no_more_than_the_slope():
    shape = line(800)
    graph = surface_graph(shape.points, 8, 0).graph
    found = local_radius(shape.points, np.full(800, 1 / 800), graph, 60, 0.06, 0.3, 0)
    entries = sparse.coo_array(graph)
    jump = np.abs(found.radius[entries.row] - found.radius[entries.col])
    assert (jump <= 0.3 * entries.data * (1 + 1e-9)).all()


def test_a_known_radius_stays_and_fewer_patches_are_grown(monkeypatch):
    shape = line(3000, radius=0.1)
    graph = surface_graph(shape.points, 8, 0).graph
    asked = shape.points[:, 0] < 0.5
    grown = []
    monkeypatch.setattr(
        thickness,
        "closing_patches",
        lambda *given: (grown.append(len(given[5])), closing_patches(*given))[1],
    )
    known = asked, np.full(3000, 7.0)
    given = shape.points, np.full(3000, 1 / 3000), graph, 100, 0.06, 0.15, 0
    whole, found = local_radius(*given), local_radius(*given, known)
    assert (found.radius[~asked] == 7.0).all()
    middle = asked & (shape.points[:, 0] > 0.2)
    assert np.median(found.radius[middle] / whole.radius[middle]) == pytest.approx(1, abs=0.05)
    assert grown == [100, np.ceil(100 * asked.mean())]


def test_where_all_is_known_nothing_is_measured():
    shape = line(400)
    graph = surface_graph(shape.points, 8, 0).graph
    known = np.zeros(400, bool), np.linspace(1.0, 2.0, 400)
    found = local_radius(shape.points, np.full(400, 1 / 400), graph, 50, 0.06, 0.15, 0, known)
    np.testing.assert_array_equal(found.radius, known[1])


# ------------------------------------------------------------------------------------- links


@given(seed=st.integers(0, 2**31), count=st.integers(1, 40), wide=st.integers(1, 6))
@settings(max_examples=40, deadline=None)
def test_links_both_ways_are_those_of_scipy(seed, count, wide):
    rng = np.random.default_rng(seed)
    indices = np.array([rng.permutation(count)[:wide] for _ in range(count)])
    length, kept = rng.uniform(0.1, 1.0, indices.shape), rng.random(indices.shape) < 0.6
    rows = np.repeat(np.arange(count), indices.shape[1])[kept.ravel()]
    one_way = sparse.csr_array((length[kept], (rows, indices[kept])), shape=(count, count))
    indptr, columns, data = both_ways(indices, length, kept)
    found = sparse.csr_array((data, columns, indptr), shape=(count, count))
    np.testing.assert_array_equal(found.toarray(), one_way.maximum(one_way.T).toarray())
    assert all((np.diff(columns[a:b]) > 0).all() for a, b in itertools.pairwise(indptr))


@given(seed=st.integers(0, 2**31), count=st.integers(1, 40), groups=st.integers(1, 9))
@settings(max_examples=40, deadline=None)
def test_links_between_groups_are_those_of_their_points(seed, count, groups):
    rng = np.random.default_rng(seed)
    links = sparse.csr_array(rng.random((count, count)) < 0.1)
    into = rng.integers(0, groups, count)
    indptr, columns = between_groups(links.indptr, links.indices, into, groups)
    found = [set(columns[a:b].tolist()) for a, b in itertools.pairwise(indptr)]
    wanted = [set() for _ in range(groups)]
    for i, j in zip(*links.nonzero(), strict=True):
        wanted[into[i]].add(int(into[j]))
    assert found == wanted
    assert len(columns) == sum(map(len, wanted))


# ------------------------------------------------------------------------- compiled, seeding


@BOTH
@pytest.mark.parametrize("first", [0, 17])
def test_farthest_points_are_those_of_brute_force(plain, first):
    points = np.random.default_rng(0).uniform(0, 1, (50, 3))
    wanted, distance = [first], cdist(points, points)
    for _ in range(19):
        wanted.append(int(np.argmax(distance[:, wanted].min(axis=1))))
    found = (farthest_points.py_func if plain else farthest_points)(
        points, np.ones(50), 20, 0.0, first
    )
    assert found.tolist() == wanted


def test_seeds_are_distinct_and_follow_their_number():
    points = np.random.default_rng(0).uniform(0, 1, (200, 3))
    for choose in (lambda s: random_points(200, 30, s), lambda s: spread_points(points, 30, s)):
        assert len(set(choose(1).tolist())) == 30
        assert choose(1).tolist() == choose(1).tolist()
        assert choose(1).tolist() != choose(2).tolist()
    assert (np.diff(random_points(200, 30, 1)) > 0).all()
    gaps = [nearest(points[c], 1).distance.min() for c in (spread_points(points, 30, 1),
                                                          random_points(200, 30, 1))]  # fmt: skip
    assert gaps[0] > 2 * gaps[1]


@BOTH
def test_the_heap_gives_its_entries_by_rising_key(plain):
    push, drop = (f.py_func if plain else f for f in (heap_push, heap_drop))
    rng = np.random.default_rng(0)
    given_keys = rng.permutation(40).astype(float)
    keys, values, size = np.empty(40), np.empty(40, np.int64), 0
    for key in given_keys:
        size = push(keys, values, size, key, int(10 * key))
    taken = []
    while size:
        taken.append((keys[0], values[0]))
        size = drop(keys, values, size)
    assert taken == [(float(k), 10 * k) for k in range(40)]


@BOTH
@pytest.mark.parametrize("size", [[3, 2, 1], [1, 1, 1], [1, 1, 0], [1, 0, 0], [1, 1e-5, 1e-7]])
def test_the_middle_eigenvalue_is_that_of_the_covariance(plain, size):
    rng = np.random.default_rng(0)
    points, mass = rng.standard_normal((50, 3)) * size, rng.uniform(1, 2, 50)
    points = points @ np.linalg.qr(rng.standard_normal((3, 3)))[0]
    second = (points * mass[:, None]).T @ points
    upper = second[np.triu_indices(3)]
    moments = np.concatenate([[mass.sum()], mass @ points, upper])
    found = (middle_eigenvalue.py_func if plain else middle_eigenvalue)(moments)
    wanted = np.linalg.eigvalsh(np.cov(points.T, aweights=mass, ddof=0))[1]
    assert found == pytest.approx(wanted, rel=1e-9, abs=1e-15)


@BOTH
def test_values_spread_along_geodesics(plain):
    points = np.random.default_rng(0).uniform(0, 1, (60, 3))
    graph = surface_graph(points, 4, 0).graph
    values = np.full(60, np.inf)
    values[[3, 30, 41]] = [0.5, 0.1, 0.9]
    way = sparse.csgraph.dijkstra(graph, indices=[3, 30, 41])
    every = np.array([0.5, 0.1, 0.9])[:, None] + 0.7 * way
    found, carried, origin = (spread_minimum.py_func if plain else spread_minimum)(
        graph.indptr, graph.indices, graph.data, values, 0.7
    )
    np.testing.assert_allclose(found, every.min(axis=0))
    reached = np.isfinite(found)
    best = way[every.argmin(axis=0), np.arange(60)]
    np.testing.assert_allclose(carried[reached], best[reached], atol=1e-12)
    wanted = np.array([3, 30, 41])[every.argmin(axis=0)]
    np.testing.assert_array_equal(origin, np.where(reached, wanted, -1))


@BOTH
def test_a_patch_closes_at_the_first_radius_that_its_variance_allows(plain):
    rng = np.random.default_rng(0)
    axis = np.linspace([0.0, 0, 0], [1, 0, 0], 11)
    points, mass = tube(axis, 0.1, 300, rng), random_mass(rng, 300)
    graph = surface_graph(points, 8, 0).graph
    sources, radii = np.array([0, 100, 200]), np.geomspace(0.1, 1.5, 12)
    scale, reach, centre = (closing_patches.py_func if plain else closing_patches)(
        graph.indptr, graph.indices, graph.data, points, mass, sources, radii, 0.06
    )
    for source, found, radius, mid in zip(sources, scale, reach, centre, strict=True):
        away = sparse.csgraph.dijkstra(graph, indices=source)
        for s in radii[radii < away.max()]:
            ball = away <= s
            cov = np.cov(points[ball].T, aweights=mass[ball], ddof=0)
            middle = np.linalg.eigvalsh(cov)[1]
            if middle <= 0.06 * s**2:
                assert radius == s
                break
        else:
            assert radius == np.inf
            middle, ball = np.linalg.eigvalsh(np.cov(points.T, aweights=mass, ddof=0))[1], mass > 0
        assert found == pytest.approx(np.sqrt(2 * middle))
        np.testing.assert_allclose(mid, np.average(points[ball], axis=0, weights=mass[ball]))


@BOTH
def test_a_patch_that_never_closes_takes_the_whole_part(plain):
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(0, 1, (150, 2)), np.zeros(150)])
    graph, mass = surface_graph(points, 8, 0).graph, np.full(150, 1 / 150)
    scale, reach, centre = (closing_patches.py_func if plain else closing_patches)(
        graph.indptr, graph.indices, graph.data, points, mass,
        np.array([7]), np.geomspace(0.2, 0.6, 8), 0.01,
    )  # fmt: skip
    assert reach[0] == np.inf
    assert scale[0] == pytest.approx(np.sqrt(2 * np.linalg.eigvalsh(np.cov(points.T, ddof=0))[1]))
    np.testing.assert_allclose(centre[0], points.mean(axis=0), atol=1e-12)


def test_patches_that_have_not_closed_say_so_where_wider_ones_follow():
    rng = np.random.default_rng(0)
    points = tube(np.linspace([0.0, 0, 0], [1, 0, 0], 41), 0.1, 3000, rng)
    graph, mass = surface_graph(points, 8, 0).graph, random_mass(rng, 3000)
    sources, radii = np.arange(0, 3000, 100), np.geomspace(0.05, 1.5, 30)
    where = graph.indptr, graph.indices, graph.data, points, mass, sources
    scale, reach, _ = closing_patches(*where, radii, 0.06)
    for count in (8, 18, 24):
        some, tried, _ = closing_patches(*where, radii[:count], 0.06, False)
        early = reach <= radii[count - 1]
        np.testing.assert_array_equal(tried[early], reach[early])
        np.testing.assert_allclose(some[early], scale[early], rtol=1e-9)
        assert (tried[~early] == WIDER).all()


def test_a_coarser_graph_keeps_mass_pieces_and_the_length_of_ways():
    shape = two_bars(6000)
    mass = random_mass(np.random.default_rng(0), len(shape.points))
    graph = surface_graph(shape.points, 8, 0).graph
    spacing = float(np.median(graph.data))
    coarse = coarsened(shape.points, mass, graph, 2 * spacing)
    assert len(coarse.points) < len(shape.points) / 5
    np.testing.assert_allclose(coarse.mass, np.bincount(coarse.into, mass))
    centre = np.average(shape.points, axis=0, weights=mass)
    np.testing.assert_allclose(np.average(coarse.points, axis=0, weights=coarse.mass), centre)
    pieces = [sparse.csgraph.connected_components(g)[0] for g in (graph, coarse.graph)]
    assert pieces[0] == pieces[1]
    long = sparse.csgraph.dijkstra(graph, indices=[5, 700])
    short = sparse.csgraph.dijkstra(coarse.graph, indices=coarse.into[[5, 700]])[:, coarse.into]
    far = np.isfinite(long) & (long > 20 * spacing)
    assert np.quantile(np.abs(short[far] / long[far] - 1), 0.9) < 0.1


def test_thickness_hardly_depends_on_how_densely_a_tube_is_sampled():
    axis = np.linspace([0.0, 0, 0], [1, 0, 0], 41)
    found = []
    for count in (1500, 6000, 24000):
        points = tube(axis, 0.1, count, np.random.default_rng(3))
        graph, mass = surface_graph(points, 8, 0).graph, np.full(count, 1 / count)
        radius = local_radius(points, mass, graph, 200, 0.06, 0.15, 0).radius
        found.append(np.median(radius[np.abs(points[:, 0] - 0.5) < 0.2]))
    np.testing.assert_allclose(found, 0.1, rtol=0.15)


def test_thickness_of_many_small_things_is_that_of_one():
    one = y_shape(600).points
    one = 0.02 * one / np.ptp(one, axis=0).max()
    cells = np.stack(np.meshgrid(*[np.arange(5) * 0.2] * 3), axis=-1).reshape(-1, 3)
    many = (one[None] + cells[:, None]).reshape(-1, 3)
    found = []
    for points in (one, many):
        graph, mass = surface_graph(points, 8, 0).graph, np.full(len(points), 1 / len(points))
        landmarks = len(points) // 12
        found.append(local_radius(points, mass, graph, landmarks, 0.06, 0.15, 0).radius)
    ratio = found[1].reshape(125, -1) / found[0]
    assert 0.9 < np.median(ratio) < 1.1
    assert np.quantile(ratio, 0.9) < 1.5


@BOTH
def test_farthest_points_end_when_every_point_has_one_near(plain):
    points = np.random.default_rng(1).uniform(0, 1, (80, 3))
    scale = np.random.default_rng(2).uniform(0.5, 2, 80)
    choose = farthest_points.py_func if plain else farthest_points
    found = choose(points, scale, 80, 0.3, 4)
    distance = cdist(points, points[found]) / scale[:, None]
    assert len(found) < 80
    assert distance.min(axis=1).max() <= 0.3
    assert (distance[:, :-1].min(axis=1) > 0.3).any()


def test_axes_of_neighbourhoods_are_those_of_their_covariance():
    rng = np.random.default_rng(4)
    points = rng.normal(0, 1, (60, 3)) * [3.0, 1.0, 0.2] + 50.0
    indices = nearest(points, 7).indices
    axes = principal_axes(points, indices)
    for i in range(60):
        patch = points[[i, *indices[i]]]
        _, wanted = np.linalg.eigh(np.cov(patch.T))
        np.testing.assert_allclose(np.abs((axes[i] * wanted).sum(axis=0)), 1.0, atol=1e-7)
