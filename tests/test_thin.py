"""Thinning: how the surface bends, which points are made one, and what stays as it was."""

from __future__ import annotations

import numpy as np
import pytest
import shapes
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import rotation

from mdcs_pipeline.errors import InputError
from mdcs_pipeline.kernels.compiled.grid import grid_of
from mdcs_pipeline.kernels.thinning import bend_radii, flat_groups, merged
from mdcs_pipeline.messages import Header, PointCloud
from mdcs_pipeline.stages.downsample import unit_frame
from mdcs_pipeline.stages.thin import Thin

HEADER = Header("map", 7, 3)


def tube(radius: float, count: int, seed: int = 0) -> np.ndarray:
    """An open tube of length 1 along z."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    around = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    return np.column_stack([around, rng.random(count)])


def thick_and_thin() -> tuple[np.ndarray, np.ndarray]:
    """Two tubes apart, as densely sampled as each other; and which points are of the thin one."""
    thick, thin = tube(0.1, 12000), tube(0.01, 1200, 1) + np.array([0.5, 0.0, 0.0])
    return np.concatenate([thick, thin]), np.arange(13200) >= 12000


def bends(points: np.ndarray, reach: float) -> np.ndarray:
    grid = grid_of(points, reach)
    inner = np.flatnonzero((grid.points[:, 2] > 0.1) & (grid.points[:, 2] < 0.9))
    return bend_radii(grid, inner[:: max(1, len(inner) // 3000)], reach)


@pytest.mark.parametrize("radius", [0.05, 0.1, 0.2])
def test_a_tube_bends_in_its_radius(radius: float) -> None:
    found = bends(tube(radius, 60000), 0.4 * radius)
    assert np.median(found) == pytest.approx(radius, rel=0.1)
    assert np.mean(abs(found / radius - 1.0) < 0.3) > 0.95


def test_a_plane_does_not_bend_and_noise_makes_a_patch_bend_more() -> None:
    rng = np.random.default_rng(0)
    plane = np.column_stack([0.0 * np.arange(6000), rng.random((6000, 2))])
    assert np.isinf(bends(plane, 0.05)).all()
    smooth = tube(0.1, 12000)
    rough = smooth + rng.normal(0.0, 0.005, smooth.shape)
    assert np.median(bends(rough, 0.04)) < 0.6 * np.median(bends(smooth, 0.04))


def test_two_sheets_close_together_are_not_flat() -> None:
    rng = np.random.default_rng(0)
    sheet = np.column_stack([np.zeros(6000), rng.random((6000, 2))])
    both = np.concatenate([sheet, sheet + np.array([0.03, 0.0, 0.0])])
    assert len(np.unique(flat_groups(sheet, 0.04, 1.5, 0))) < 1000
    assert len(np.unique(flat_groups(both, 0.04, 1.5, 0))) == len(both)


def test_what_is_thick_is_thinned_and_what_is_thin_is_not() -> None:
    points, thin = thick_and_thin()
    group = flat_groups(points, 0.03, 1.5, 0)
    size = np.bincount(group)
    assert (size[group[thin]] == 1).all()
    assert len(np.unique(group[~thin])) < 0.15 * (~thin).sum()
    # One cell holds what was made one.
    for name in np.flatnonzero(size > 1)[:50]:
        assert np.ptp(points[group == name], axis=0).max() <= 0.03


@pytest.mark.parametrize("enough", [0, 2000, 5000, 13000, 13200, 20000])
def test_as_many_are_left_as_are_enough(enough: int) -> None:
    points, _ = thick_and_thin()
    least = len(np.unique(flat_groups(points, 0.03, 1.5, 0)))
    left = len(np.unique(flat_groups(points, 0.03, 1.5, enough)))
    assert left >= min(enough, len(points))
    # No cell of so dense a tube holds more points than this.
    assert left <= max(least, min(enough, len(points)) + 60)


def test_the_flattest_places_are_thinned_first() -> None:
    wide, narrow = tube(0.2, 9000), tube(0.08, 3600, 1) + np.array([0.6, 0.0, 0.0])
    points = np.concatenate([wide, narrow])
    group = flat_groups(points, 0.03, 1.5, 8000)
    joined = np.bincount(group)[group] > 1
    assert joined[:9000].mean() > 0.4
    assert joined[9000:].mean() < 0.02


def test_groups_are_numbered_as_their_first_points_come() -> None:
    points, _ = thick_and_thin()
    group = flat_groups(points, 0.03, 1.5, 0)
    first = np.unique(group, return_index=True)[1]
    assert (np.diff(first) > 0).all()
    assert flat_groups(points[:0], 0.03, 1.5, 0).shape == (0,)


def test_means_are_weighed_and_what_is_alone_keeps_its_place() -> None:
    rng = np.random.default_rng(0)
    points, weights = 1e6 + rng.random((6, 3)), rng.random(6) + 0.1
    group = np.array([0, 1, 0, 2, 1, 0])
    found = merged(points, weights, group)
    for name in range(3):
        mine = group == name
        mean = np.average(points[mine], axis=0, weights=weights[mine])
        np.testing.assert_allclose(found.centroids[name], mean, rtol=1e-15)
    np.testing.assert_array_equal(found.centroids[2], points[3])
    np.testing.assert_allclose(found.weights, [weights[group == k].sum() for k in range(3)])


def test_the_stage_keeps_weight_centre_and_header() -> None:
    points, _ = thick_and_thin()
    weights = np.random.default_rng(1).random(len(points)) + 0.5
    cloud = PointCloud(points, weights, HEADER, dropped=4)
    found = Thin(voxel=0.03, enough=0)(cloud).cloud
    assert found.weights is not None
    assert len(found) < 0.3 * len(cloud)
    assert found.weights.sum() == pytest.approx(weights.sum(), rel=1e-12)
    np.testing.assert_allclose(
        np.average(found.positions, axis=0, weights=found.weights),
        np.average(points, axis=0, weights=weights),
        atol=1e-12,
    )
    assert (found.header, found.dropped) == (HEADER, 4)


def test_small_clouds_pass_as_they_are() -> None:
    cloud = PointCloud(tube(0.2, 3000), header=HEADER)
    assert Thin(enough=3000)(cloud).cloud is cloud
    assert len(Thin(voxel=0.05, enough=2000)(cloud).cloud) < 3000
    empty = PointCloud(np.empty((0, 3)))
    assert len(Thin()(empty).cloud) == 0


def test_a_voxel_can_be_given_in_input_units() -> None:
    points = 100.0 * tube(0.2, 3000)
    given_size = Thin(voxel_size=5.0, enough=0)(PointCloud(points)).cloud
    unit = unit_frame(PointCloud(points)).length
    same = Thin(voxel=5.0 / unit, enough=0)(PointCloud(points)).cloud
    assert len(given_size) < 2000
    np.testing.assert_array_equal(given_size.positions, same.positions)


def test_points_in_one_place_are_refused() -> None:
    with pytest.raises(InputError, match="all points coincide"):
        Thin(enough=5)(PointCloud(np.full((9, 3), 2.5)))


@given(seed=st.integers(0, 10_000), scale=st.sampled_from([1e-3, 1.0, 1e4]))
@settings(max_examples=10, deadline=None)
def test_the_result_moves_with_the_cloud_whatever_its_order(seed: int, scale: float) -> None:
    points = shapes.y(6000)
    turn, order = rotation(seed), np.random.default_rng(seed).permutation(len(points))
    stage = Thin(voxel=0.03, enough=0)
    here = stage(PointCloud(points)).cloud
    there = stage(PointCloud((scale * (points @ turn.T + 3.0))[order])).cloud
    assert 0.1 * len(points) < len(here) < 0.6 * len(points)
    back = (there.positions / scale - 3.0) @ turn
    gap = np.linalg.norm(here.positions[:, None] - back[None], axis=2)
    assert len(here) == len(there)
    np.testing.assert_allclose(gap.min(axis=1), 0.0, atol=1e-9)
