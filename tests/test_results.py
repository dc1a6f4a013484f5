"""Skeletons of shapes whose skeleton is known, and what must not change them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import shapes

import mdcs_pipeline as mdcs
from mdcs_pipeline.messages import Header, PointCloud, Skeleton

CONFIGS = ("default", "paper")
SEEDS = range(10)
Counts = tuple[int, int, int, int]

#: Components, loops, ends, junctions.
TORUS: Counts = (1, 1, 0, 0)
Y: Counts = (1, 0, 3, 1)
TWO_BARS: Counts = (2, 0, 4, 0)
ROD: Counts = (1, 0, 2, 0)


def counts(skeleton: Skeleton) -> Counts:
    found = skeleton.summary()
    return found["components"], found["cycles"], found["leaves"], found["junctions"]


def diagonal(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


# --- topology


@pytest.mark.parametrize("count", [1000, 2000])
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    ("shape", "wanted"),
    [(shapes.torus, TORUS), (shapes.y, Y), (shapes.two_bars, TWO_BARS)],
    ids=["torus", "y", "two_bars"],
)
def test_topology_over_ten_seeds(
    shape: Callable[..., np.ndarray], wanted: Counts, seed: int, count: int
) -> None:
    found = mdcs.skeletonize(shape(count, seed), seed={"seed": seed})
    assert counts(found) == wanted
    assert found.diagnostics["exhausted"] == []


@pytest.mark.parametrize("seed", range(3))
def test_a_rod_is_a_line_and_a_ball_has_no_loop(seed: int) -> None:
    assert counts(mdcs.skeletonize(shapes.cylinder(1000, seed), seed={"seed": seed})) == ROD
    ball = mdcs.skeletonize(shapes.ball(1000, seed), seed={"seed": seed}).summary()
    assert (ball["components"], ball["cycles"]) == (1, 0)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_noisy_y_keeps_its_ends(seed: int) -> None:
    """Noise of a quarter of a limb's radius."""
    points = shapes.y(2000, seed)
    points += np.random.default_rng(seed).normal(scale=0.025, size=points.shape)
    assert counts(mdcs.skeletonize(points, seed={"seed": seed})) == Y


@pytest.mark.parametrize("seed", SEEDS)
def test_a_y_among_outliers_keeps_its_ends(seed: int) -> None:
    """One point in twenty lies anywhere in a box that is larger than the shape."""
    points = shapes.y(2000, seed)
    low, high = points.min(axis=0) - 0.3, points.max(axis=0) + 0.3
    stray = np.random.default_rng(seed).uniform(low, high, (len(points) // 20, 3))
    assert counts(mdcs.skeletonize(np.concatenate([points, stray]), seed={"seed": seed})) == Y


# --- places, mass and radius


@pytest.fixture(scope="module")
def ring() -> Skeleton:
    return mdcs.skeletonize(shapes.torus(2000, 0))


def test_nodes_of_a_torus_stand_on_its_ring(ring: Skeleton) -> None:
    away = np.hypot(np.hypot(*ring.nodes[:, :2].T) - shapes.RING, ring.nodes[:, 2])
    assert away.max() < 0.25 * shapes.TUBE


@pytest.mark.parametrize("seed", range(3))
def test_the_radius_of_a_torus_is_its_tube(seed: int) -> None:
    radius = mdcs.skeletonize(shapes.torus(2000, seed), seed={"seed": seed}).radius
    assert np.abs(radius - shapes.TUBE).max() <= 0.25 * shapes.TUBE


def test_the_radius_of_a_torus_is_even(ring: Skeleton) -> None:
    assert np.ptp(ring.radius) < 0.1 * ring.radius.mean()


def test_the_radius_follows_the_thickness() -> None:
    """The same shape at twice the width has twice the radius, within what meshing it costs."""
    rod = shapes.cylinder(1500, 0)
    thick = rod * [1.0, 2.0, 2.0]
    ratio = mdcs.skeletonize(thick).radius.mean() / mdcs.skeletonize(rod).radius.mean()
    assert 1.7 < ratio < 2.3


@pytest.mark.parametrize("config", CONFIGS)
@pytest.mark.parametrize("shape", [shapes.torus, shapes.y, shapes.two_bars, shapes.ball])
def test_mass_is_positive_and_sums_to_one(shape: Callable[..., np.ndarray], config: str) -> None:
    found = mdcs.skeletonize(shape(1000, 3), config)
    assert found.mass.min() > 0
    assert abs(found.mass.sum() - 1) <= 1e-9
    assert found.radius.min() > 0
    assert len(np.unique(found.node_ids)) == len(found)


@pytest.mark.parametrize("config", CONFIGS)
def test_nodes_lie_within_the_cloud(config: str) -> None:
    points = shapes.y(1500, 5) + 40
    nodes = mdcs.skeletonize(points, config).nodes
    assert (nodes >= points.min(axis=0)).all()
    assert (nodes <= points.max(axis=0)).all()


# --- what must not matter


@pytest.fixture(scope="module")
def plain() -> dict[tuple[str, int], Skeleton]:
    return {
        (config, seed): mdcs.skeletonize(shapes.y(1500, seed), config)
        for config in CONFIGS
        for seed in range(3)
    }


def assert_same(found: Skeleton, wanted: Skeleton, size: float, scale: float = 1.0) -> None:
    """Compare two skeletons of which `found` was mapped back into the frame of `wanted`."""
    np.testing.assert_array_equal(found.edges, wanted.edges)
    np.testing.assert_allclose(found.nodes, wanted.nodes, rtol=0, atol=1e-6 * size)
    np.testing.assert_allclose(found.mass, wanted.mass, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.radius / scale, wanted.radius, rtol=0, atol=1e-6 * size)
    np.testing.assert_array_equal(found.node_ids, wanted.node_ids)


def mapped_back(found: Skeleton, back: Callable[[np.ndarray], np.ndarray]) -> Skeleton:
    return Skeleton(back(found.nodes), found.edges, found.mass, found.radius, found.node_ids)


each = pytest.mark.parametrize(
    ("config", "seed"), [(config, seed) for config in CONFIGS for seed in range(3)]
)


@each
def test_rigid_motion(plain: dict[tuple[str, int], Skeleton], config: str, seed: int) -> None:
    points, turn, shift = shapes.y(1500, seed), shapes.turned(seed), np.array([3.0, -20, 7])
    found = mdcs.skeletonize(points @ turn.T + shift, config)
    back = mapped_back(found, lambda nodes: (nodes - shift) @ turn)
    assert_same(back, plain[config, seed], diagonal(points))


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 37.0, 1e9])
@each
def test_scale(
    plain: dict[tuple[str, int], Skeleton], config: str, seed: int, scale: float
) -> None:
    points = shapes.y(1500, seed)
    found = mdcs.skeletonize(points * scale, config)
    back = mapped_back(found, lambda nodes: nodes / scale)
    assert_same(back, plain[config, seed], diagonal(points), scale)


@each
def test_point_order(plain: dict[tuple[str, int], Skeleton], config: str, seed: int) -> None:
    points = shapes.y(1500, seed)
    for mixed in (points[::-1], np.random.default_rng(seed).permutation(points)):
        assert_same(mdcs.skeletonize(mixed, config), plain[config, seed], diagonal(points))


@pytest.mark.parametrize("config", CONFIGS)
def test_two_runs_give_the_same_bits(plain: dict[tuple[str, int], Skeleton], config: str) -> None:
    points = shapes.y(1500, 0)
    with mdcs.Pipeline.from_config(config) as pipe:
        pipe.push(shapes.torus(800, 1))
        again = pipe.push(points)
    for name in ("nodes", "edges", "mass", "radius", "node_ids"):
        found, wanted = getattr(again, name), getattr(plain[config, 0], name)
        assert found.tobytes() == wanted.tobytes()
    volatile = {"seconds"}
    wanted = plain[config, 0].diagnostics
    assert {k: v for k, v in again.diagnostics.items() if k not in volatile} == {
        k: v for k, v in wanted.items() if k not in volatile
    }


def test_another_seed_is_another_draw() -> None:
    points = shapes.y(1000, 0)
    drawn = [
        mdcs.skeletonize(points, seed={"seed": seed, "choice": "random"}).nodes for seed in range(2)
    ]
    assert drawn[0].shape != drawn[1].shape or not np.allclose(drawn[0], drawn[1])


# --- what comes along


@pytest.mark.parametrize("config", CONFIGS)
def test_the_header_is_copied(config: str) -> None:
    points = shapes.y(800, 0)
    with mdcs.Pipeline.from_config(config) as pipe:
        for seq in range(2):
            found = pipe.push(points, stamp_ns=123 + seq, frame_id="map")
            assert found.header == Header("map", 123 + seq, seq)
        own = pipe.push(PointCloud(points, header=Header("lidar", 5, 77)))
    assert own.header == Header("lidar", 5, 2)


@pytest.mark.parametrize("config", CONFIGS)
@pytest.mark.parametrize("shape", [shapes.torus, shapes.y, shapes.two_bars])
def test_every_input_point_is_assigned(shape: Callable[..., np.ndarray], config: str) -> None:
    points = shape(4000, 0)
    found = mdcs.skeletonize(points, config, smooth={"assign": True})
    assert found.diagnostics["points"] < len(points), "the cloud was not downsampled"
    assert found.assignment is not None
    assert found.assignment.shape == (len(points),)
    assert found.assignment.dtype == np.int64
    away = np.linalg.norm(points - found.nodes[found.assignment], axis=1)
    assert (away <= 3 * found.radius[found.assignment]).mean() > 0.95


def test_points_are_assigned_to_their_own_piece() -> None:
    points = shapes.two_bars(2000, 0)
    found = mdcs.skeletonize(points, smooth={"assign": True})
    assert found.assignment is not None
    np.testing.assert_array_equal(found.nodes[found.assignment, 1] > 0, points[:, 1] > 0)
    assert set(found.assignment.tolist()) == set(range(len(found)))


def test_nothing_is_assigned_unless_asked_for(ring: Skeleton) -> None:
    assert ring.assignment is None


def test_the_run_is_described(ring: Skeleton) -> None:
    held: dict[str, Any] = ring.diagnostics
    assert held["converged"] is True
    assert held["dropped"] == 0
    assert 0 < held["rough_nodes"] <= len(ring)
    assert held["marginal_error"] <= 1e-3
    assert held["seconds"].keys() >= {"downsample", "transport", "smooth"}


def test_the_last_digit_of_a_coordinate_moves_nothing():
    """Two thin tubes that cross, 400 points: near points must not change sides on a rounding."""
    tubes = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        along, around = rng.uniform(0, 2, 200), rng.uniform(0, 2 * np.pi, 200)
        tube = np.c_[along, 0.1 * np.cos(around), 0.1 * np.sin(around)].astype(np.float32)
        tubes.append(tube[:, [seed, 1 - seed, 2]] - np.eye(3)[seed])
    cross = np.concatenate(tubes).astype(np.float32)
    points = np.c_[-cross[:, 1], cross[:, 0], cross[:, 2]] + np.array([1.5, 2, 3])
    known = mdcs.skeletonize(points)
    for seed in range(3):
        rounding = 1e-15 * np.random.default_rng(seed).standard_normal(points.shape)
        found = mdcs.skeletonize(points + rounding)
        np.testing.assert_allclose(found.nodes, known.nodes, atol=1e-9)
