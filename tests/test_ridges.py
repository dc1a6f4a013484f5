"""Ridges of noisy clouds: scale and places of known limbs, what moves with them, and the stage."""

from __future__ import annotations

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from scipy import sparse

import mdcs_pipeline as mdcs
from mdcs_pipeline.errors import InputError
from mdcs_pipeline.kernels import ridges as kernel
from mdcs_pipeline.kernels import saddles
from mdcs_pipeline.kernels.compiled.grid import grid_of
from mdcs_pipeline.kernels.compiled.ridge import climbed
from mdcs_pipeline.kernels.ridges import RidgeRule, Ridges, levelled, ridges, surface_noise
from mdcs_pipeline.kernels.surface import surface_graph
from mdcs_pipeline.messages import MassCloud, PointCloud, Surface, Thickness
from mdcs_pipeline.stages.density import Density
from mdcs_pipeline.stages.medial import Medial
from mdcs_pipeline.stages.ridge import Ridge
from mdcs_pipeline.stages.surface import SurfaceGraph
from mdcs_pipeline.stages.thickness import LocalThickness

FloatArray = NDArray[np.float64]

R = 0.1
RULE = RidgeRule()


def tube(noise: float, seed: int = 0, count: int = 3000, y: float = 0.0) -> FloatArray:
    """Return a tube of radius R along x from 0 to 1.6, with noise in that radius."""
    rng = np.random.default_rng(seed)
    angle, x = rng.uniform(0, 2 * np.pi, count), rng.uniform(0, 1.6, count)
    skin = np.stack([x, y + R * np.cos(angle), R * np.sin(angle)], axis=1)
    return skin + noise * R * rng.normal(size=(count, 3))


def found(points: FloatArray, guess: float = R, rule: RidgeRule = RULE) -> Ridges:
    count = len(points)
    graph = surface_graph(points, 8).graph
    mass = Density()(PointCloud(points)).cloud.mass
    result = ridges(points, mass, np.full(count, guess), graph, rule)
    assert result is not None
    return result


def noise_of(points: FloatArray, guess: float = R) -> float:
    mass = Density()(PointCloud(points)).cloud.mass
    return surface_noise(points, mass, np.full(len(points), guess), RULE)


def inner(points: FloatArray) -> NDArray[np.bool_]:
    """Return the points that are well within the tube's length."""
    return np.asarray((points[:, 0] > 0.25) & (points[:, 0] < 1.35))


# --- scale and places


@pytest.mark.parametrize("noise", [0.0, 0.3, 0.5])
@pytest.mark.parametrize("guess", [0.65, 1.0, 1.6])
def test_a_tube_has_its_axis_and_its_radius_whatever_the_noise_and_the_first_guess(
    noise: float, guess: float
) -> None:
    points = tube(noise)
    ridge = found(points, guess * R)
    some = inner(points)
    away = np.linalg.norm(ridge.places[some, 1:], axis=1)
    assert np.median(away) < 0.2 * R
    assert np.quantile(away, 0.95) < 0.5 * R
    np.testing.assert_allclose(np.median(ridge.radius[some]), R, rtol=0.08)
    assert np.median(np.abs(ridge.axes[some, 0])) > 0.9


def test_a_tube_of_few_points_has_its_scale_all_the_same() -> None:
    """Their covariance is too thin by chance, the more so the smaller the window is."""
    scales = []
    for count in (3000, 300, 120):
        ridge = found(tube(0.4, count=count), 1.2 * R)
        scales.append(float(np.median(ridge.radius)))
    np.testing.assert_allclose(scales, R, rtol=0.2)


def test_masses_whose_squares_are_nothing_pull_as_others_do() -> None:
    points = tube(0.3, count=300)
    grid, every = grid_of(points, R), np.arange(300)
    faint, firm = (
        climbed(grid, np.full(300, mass), points.copy(), np.full(300, R), every)
        for mass in (1e-200, 1.0)
    )
    np.testing.assert_allclose(faint[0], firm[0], atol=1e-9)


def test_places_stay_where_points_are_along_the_axis() -> None:
    points = tube(0.4)
    some = inner(points)
    # Ridges meander by what the sampling leaves to chance.
    moved = np.abs(found(points).places[some, 0] - points[some, 0])
    assert np.quantile(moved, 0.95) < 0.5 * R


def test_the_noise_is_told_from_the_spread_about_the_ridge() -> None:
    told = [noise_of(tube(noise)) for noise in (0.0, 0.15, 0.3, 0.5)]
    assert told == sorted(told)
    assert told[0] < 0.1
    np.testing.assert_allclose(told[1:3], (0.15, 0.26), atol=0.05)


def test_limbs_side_by_side_keep_their_axes_and_their_radius() -> None:
    points = np.concatenate([tube(0.3, 0), tube(0.3, 1, y=3.2 * R)])
    ridge = found(points, 1.3 * R)
    some = inner(points)
    own = np.repeat([0.0, 3.2 * R], 3000)
    away = np.hypot(ridge.places[:, 1] - own, ridge.places[:, 2])[some]
    assert np.mean(away < 0.7 * R) > 0.8
    np.testing.assert_allclose(np.median(ridge.radius[some]), R, rtol=0.1)


def on_saddle() -> float:
    """Return the share of places between two limbs; the gap is 0.8 radii wide, noise 0.3 a side."""
    points = np.concatenate([tube(0.3, 0), tube(0.3, 1, y=2.8 * R)])
    places = found(points).places[inner(points)]
    return float(np.mean(np.abs(places[:, 1] - 1.4 * R) < 0.7 * R))


def test_what_limbs_explain_takes_places_off_the_saddle_between_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = on_saddle()
    monkeypatch.setattr(kernel, "_ROUNDS", 0)
    assert now < 0.4 * on_saddle()


def test_points_on_a_saddle_go_to_the_limb_that_explains_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = on_saddle()
    monkeypatch.setattr(saddles, "_HOLLOW", 0.0)
    assert now < 0.7 * on_saddle()


def test_levelled_points_are_as_far_from_the_axis_as_the_limb_is_thick() -> None:
    points = tube(0.4)
    ridge = found(points)
    level = levelled(points, ridge)
    across = level - ridge.places
    across -= (across * ridge.axes).sum(axis=1, keepdims=True) * ridge.axes
    np.testing.assert_allclose(np.linalg.norm(across, axis=1), ridge.radius, rtol=1e-9)
    moved = level - points
    np.testing.assert_allclose((moved * ridge.axes).sum(axis=1), 0, atol=1e-12)


def test_a_point_on_its_ridge_has_no_side_to_be_moved_to() -> None:
    here = np.array([[0.5, 0.0, 0.0]])
    ridge = Ridges(here, np.array([[1.0, 0, 0]]), np.array([R]))
    np.testing.assert_array_equal(levelled(here, ridge), here)


def test_too_few_points_have_no_scale() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0]])
    graph = sparse.csr_array(np.array([[0, 1.0], [1.0, 0]]))
    assert ridges(points, np.full(2, 0.5), np.full(2, R), graph, RULE) is None
    assert surface_noise(points, np.full(2, 0.5), np.full(2, R), RULE) == 0.0


# --- what moves with the cloud


def test_ridges_move_turn_and_grow_with_the_cloud() -> None:
    points, (turn, _) = tube(0.3), np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
    moved = 7.0 * points @ turn.T + [3.0, -2.0, 1.0]
    here, there = found(points), found(moved, 7.0 * R)
    some = inner(points)
    back = (there.places - [3.0, -2.0, 1.0]) @ turn / 7.0
    # Other points stand for the rest, so it is the ridge that is the same, not every place on it.
    assert np.median(np.linalg.norm((back - here.places)[some], axis=1)) < 0.2 * R
    np.testing.assert_allclose(np.median(there.radius), 7 * np.median(here.radius), rtol=0.03)
    np.testing.assert_allclose(noise_of(moved, 7.0 * R), noise_of(points), rtol=0.15)


def test_only_shares_of_mass_count() -> None:
    points = tube(0.3)
    graph, count = surface_graph(points, 8).graph, len(points)
    one, other = (
        ridges(points, np.full(count, mass), np.full(count, R), graph, RULE)
        for mass in (1 / count, 4.0)
    )
    assert one is not None
    assert other is not None
    np.testing.assert_allclose(one.places, other.places, atol=1e-9)


# --- the stage


def measured(points: FloatArray) -> tuple[MassCloud, Surface, Thickness]:
    cloud = Density()(PointCloud(points)).cloud
    surface = SurfaceGraph()(cloud).surface
    thickness = LocalThickness()(cloud, surface).thickness
    medial = Medial()(cloud, surface, thickness)
    return cloud, medial.surface, medial.thickness


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_cloud_whose_surface_shows_stays_as_it_is(noise: float) -> None:
    cloud, surface, thickness = measured(tube(noise))
    result = Ridge(unsure=0.0)(cloud, surface, thickness)
    assert result.thickness is thickness
    assert result.surface is surface


def test_a_noisy_cloud_is_carried_from_its_ridge() -> None:
    points = tube(0.5)
    cloud, surface, thickness = measured(points)
    result = Ridge()(cloud, surface, thickness)
    assert thickness.centre is not None
    assert result.thickness.centre is not None

    def away(places: FloatArray) -> float:
        back = cloud.unit.from_unit(places)[inner(points)]
        return float(np.median(np.linalg.norm(back[:, 1:], axis=1)))

    assert away(thickness.centre) > 0.7 * R
    assert away(result.thickness.centre) < 0.2 * R
    assert result.thickness.trust is not None
    assert result.thickness.normal is not None
    assert (result.thickness.trust == 1).all()
    np.testing.assert_allclose(np.linalg.norm(result.thickness.normal, axis=1), 1.0)
    # The surface, too, is that of a tube without noise.
    level = cloud.unit.from_unit(result.surface.positions)[inner(points)]
    assert np.std(np.linalg.norm(level[:, 1:], axis=1)) < 0.25 * R


def test_the_threshold_decides_what_is_noisy() -> None:
    given = measured(tube(0.5))
    assert Ridge(noise=1.0)(*given).thickness is given[2]
    assert Ridge(noise=0.1)(*given).thickness is not given[2]


def test_centres_that_nobody_vouches_for_are_refused() -> None:
    cloud, surface, thickness = measured(tube(0.3, count=500))
    bare = Thickness(thickness.radius, thickness.confidence)
    with pytest.raises(InputError) as caught:
        Ridge()(cloud, surface, bare)
    assert "medial" in caught.value.remedy


# --- the pipeline


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_limbs_of_a_noisy_y_are_all_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = shapes.y(6000, seed)
    made = mdcs.skeletonize(points + 0.05 * rng.normal(size=points.shape))
    degree = np.bincount(np.asarray(made.edges).ravel(), minlength=len(made.nodes))
    assert len(made.edges) == len(made.nodes) - 1
    assert np.count_nonzero(degree == 1) == 3
