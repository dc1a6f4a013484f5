"""Clouds that are no good: a right result, or an error that says what, where and what to do.

Warnings are errors here: a division by zero on the way to a result is no right result.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import shapes

import mdcs_pipeline as mdcs
from mdcs_pipeline.errors import InputError
from mdcs_pipeline.messages import Skeleton

pytestmark = pytest.mark.filterwarnings("error")

CONFIGS = ("default", "paper")
each_config = pytest.mark.parametrize("config", CONFIGS)
Y = shapes.y(1500, 0)
NAN, INF = float("nan"), float("inf")
DIRECTION = np.array([1.0, 0.3, -0.2])


def run(points: Any, config: str = "default", **settings: Any) -> Skeleton:
    """Skeletonize, and look whether the caller's array is as it was."""
    held = points if isinstance(points, np.ndarray) else None
    before = None if held is None else (held.tobytes(), held.dtype, held.shape, held.strides)
    try:
        return mdcs.skeletonize(points, config, **settings)
    finally:
        if held is not None:
            assert (held.tobytes(), held.dtype, held.shape, held.strides) == before
            assert held.flags.writeable


def refused(points: Any, said: str, config: str = "default", **settings: Any) -> InputError:
    """Return the error, which must say what, where and what to do."""
    with pytest.raises(InputError, match=said) as caught:
        run(points, config, **settings)
    error = caught.value
    assert error.what
    assert error.where
    assert error.remedy
    return error


def assert_sound(found: Skeleton, points: np.ndarray, room: float = 1e-9) -> None:
    """Check what every result must be, however little the cloud says.

    Nodes lie in the cloud's box, with `room` around it as a share of its largest coordinate.
    """
    margin = room * np.abs(points).max()
    assert len(found) >= 1
    assert (found.nodes >= points.min(axis=0) - margin).all()
    assert (found.nodes <= points.max(axis=0) + margin).all()
    assert abs(found.mass.sum() - 1) <= 1e-9
    assert np.isfinite(found.radius).all()


def counts(found: Skeleton) -> tuple[int, int, int]:
    held = found.summary()
    return held["components"], held["cycles"], held["leaves"]


def assert_same(found: Skeleton, wanted: Skeleton, atol: float) -> None:
    np.testing.assert_array_equal(found.edges, wanted.edges)
    np.testing.assert_allclose(found.nodes, wanted.nodes, rtol=0, atol=atol)


@pytest.fixture(scope="module")
def plain() -> dict[str, Skeleton]:
    return {config: mdcs.skeletonize(Y, config) for config in CONFIGS}


# --- too few points


@each_config
@pytest.mark.parametrize("empty", [np.empty((0, 3)), np.empty((0, 3), np.float32)])
def test_an_empty_cloud_is_refused(empty: np.ndarray, config: str) -> None:
    assert "source 'cloud'" in str(refused(empty, "the cloud is empty", config))


@each_config
@pytest.mark.parametrize("count", [1, 2, 3])
def test_fewer_than_four_points_are_refused(count: int, config: str) -> None:
    points = np.random.default_rng(count).normal(size=(count, 3))
    refused(points, "all points coincide" if count == 1 else "at least 4 points", config)


@each_config
@pytest.mark.parametrize("count", range(4, 11))
@pytest.mark.parametrize("kind", ["scattered", "corners", "line", "plane"])
def test_a_few_points_give_a_sound_result(kind: str, count: int, config: str) -> None:
    """Straightening may lift nodes out of the box of so few points, by little."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        points = rng.normal(size=(count, 3))
        if kind == "corners":
            points = rng.integers(0, 2, size=(count, 3)).astype(float)
        if kind == "line":
            points = points[:, :1] * DIRECTION
        if kind == "plane":
            points[:, 2] = 0
        if len(np.unique(points, axis=0)) < 4:
            refused(points, "at least 4 points", config)
            continue
        found = run(points, config)
        assert_sound(found, points, room=0.2)
        if config == "default":
            assert found.summary()["cycles"] == 0


@each_config
def test_the_eight_corners_of_a_cube(config: str) -> None:
    """In paper each corner had a node on it, at distance 0 from all that it served."""
    points = np.stack(np.meshgrid([0.0, 1], [0.0, 1], [0.0, 1]), -1).reshape(-1, 3)
    assert_sound(run(points, config), points)


# --- points that are not finite


@each_config
@pytest.mark.parametrize("value", [NAN, INF, -INF])
def test_nonfinite_points_are_dropped_and_counted(
    plain: dict[str, Skeleton], value: float, config: str
) -> None:
    holed = np.insert(Y, [0, 3, 700, len(Y)], [value, 0.0, 0.0], axis=0)
    found = run(holed, config)
    assert found.diagnostics["dropped"] == 4
    assert_same(found, plain[config], 1e-12)


@each_config
def test_nonfinite_points_are_refused_on_request(config: str) -> None:
    holed = Y.copy()
    holed[[5, 9], [0, 2]] = NAN, INF
    settings = {"sources": {"cloud": {"nonfinite": "refuse"}}}
    error = refused(holed, "2 of 1212 points hold NaN or infinity", config, **settings)
    assert error.received == "first in row 5"
    assert run(Y, config, **settings).diagnostics["dropped"] == 0


@each_config
@pytest.mark.parametrize("value", [NAN, INF])
def test_clouds_without_a_finite_point_are_refused(value: float, config: str) -> None:
    refused(np.full((50, 3), value), "all points hold NaN or infinity", config)


@each_config
def test_too_few_finite_points_are_refused(config: str) -> None:
    holed = np.full((50, 3), NAN)
    holed[:3] = np.eye(3)
    refused(holed, "at least 4 points", config)


# --- clouds without a volume or an extent


@each_config
@pytest.mark.parametrize("place", [0.0, 1.0, 1e6 + 0.1, -1e-9])
@pytest.mark.parametrize("count", [4, 100])
def test_points_that_all_coincide_are_refused(count: int, place: float, config: str) -> None:
    refused(np.full((count, 3), place), "all points coincide", config)


@each_config
def test_points_in_two_places_are_refused(config: str) -> None:
    refused(np.repeat([[0.0, 0, 0], [1, 2, 3]], 50, axis=0), "at least 4 points", config)


@each_config
def test_a_shape_lost_in_the_round_off_of_its_place_is_refused(config: str) -> None:
    refused(Y * 1e-9 + 1e6, "all points coincide", config)


def assert_on_line(found: Skeleton, points: np.ndarray) -> None:
    """A right result for collinear points: one line along them, from end to end."""
    assert_sound(found, points)
    assert counts(found) == (1, 0, 2)
    offset = found.nodes - points.mean(axis=0)
    along = offset @ DIRECTION / (DIRECTION @ DIRECTION)
    size = np.linalg.norm(np.ptp(points, axis=0))
    assert np.linalg.norm(offset - along[:, None] * DIRECTION, axis=1).max() < 1e-9 * max(
        size, np.abs(points).max()
    )
    assert np.linalg.norm(np.ptp(found.nodes, axis=0)) > 0.8 * size


@pytest.mark.parametrize("count", [20, 60, 100, 200, 500])
def test_collinear_points_give_a_line(count: int) -> None:
    points = np.linspace(-1, 1, count)[:, None] * DIRECTION
    assert_on_line(run(points), points)


UNEVEN = [(60, 3), (100, 0), (100, 1), (200, 0), (400, 0)]


@pytest.mark.parametrize(("count", "seed"), UNEVEN)
def test_uneven_collinear_points_give_a_line(count: int, seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-1, 1, count)[:, None] * DIRECTION
    assert_on_line(run(points), points)


@each_config
def test_coplanar_points_give_nodes_in_their_plane(config: str) -> None:
    """A filled rectangle, evenly and unevenly sampled; tilted, so that no axis is special."""
    rng, turn = np.random.default_rng(0), shapes.turned(1)
    grid = np.stack(np.meshgrid(np.linspace(0, 2, 40), np.linspace(0, 1, 20)), -1).reshape(-1, 2)
    for flat in (grid, rng.uniform([0, 0], [2, 1], (1000, 2))):
        points = np.column_stack([flat, np.zeros(len(flat))])
        found = run(points @ turn.T + 5, config)
        nodes = (found.nodes - 5) @ turn
        assert np.abs(nodes[:, 2]).max() < 1e-9
        assert (nodes[:, :2] >= 0).all()
        assert (nodes[:, :2] <= [2, 1]).all()
        if config == "default":
            assert counts(found)[:2] == (1, 0)


@each_config
def test_exact_duplicates_change_nothing(plain: dict[str, Skeleton], config: str) -> None:
    assert_same(run(np.repeat(Y, 3, axis=0), config), plain[config], 1e-9)


# --- scales and places


@each_config
@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_scales(plain: dict[str, Skeleton], scale: float, config: str) -> None:
    found = run(Y * scale, config)
    np.testing.assert_array_equal(found.edges, plain[config].edges)
    np.testing.assert_allclose(found.nodes / scale, plain[config].nodes, rtol=0, atol=1e-9)


@each_config
@pytest.mark.parametrize("scale", [1e-150, 1e-300, 1e150, 1e300])
def test_scales_that_cannot_be_squared_are_refused(scale: float, config: str) -> None:
    refused(Y * scale, "size must lie between|all points coincide", config)


@each_config
@pytest.mark.parametrize("place", [1e6, -1e6])
def test_far_from_the_origin(plain: dict[str, Skeleton], place: float, config: str) -> None:
    found = run(Y + place, config)
    np.testing.assert_array_equal(found.edges, plain[config].edges)
    np.testing.assert_allclose(found.nodes - place, plain[config].nodes, rtol=0, atol=1e-7)


# --- types and layouts


@each_config
@pytest.mark.parametrize(
    "make",
    [
        np.asfortranarray,
        lambda p: np.repeat(p, 2, axis=0)[::2],
        lambda p: np.repeat(p, 2, axis=1)[:, ::2],
        lambda p: p.astype(">f8"),
        lambda p: p.astype(np.longdouble),
        lambda p: np.ma.array(p),
        lambda p: p.tolist(),
    ],
    ids=[
        "fortran",
        "every_other_row",
        "every_other_column",
        "big_endian",
        "long",
        "masked",
        "list",
    ],
)
def test_layouts_change_nothing(plain: dict[str, Skeleton], make: Any, config: str) -> None:
    assert_same(run(make(Y.copy()), config), plain[config], 1e-12)


@each_config
def test_float32(plain: dict[str, Skeleton], config: str) -> None:
    assert_same(run(Y.astype(np.float32), config), plain[config], 1e-6)


@pytest.mark.parametrize("dtype", [np.int64, np.int32, np.int16, np.uint8])
@each_config
def test_integers_are_the_floats_that_they_equal(dtype: type, config: str) -> None:
    whole = np.round((Y - Y.min(axis=0)) * 120)
    assert_same(run(whole.astype(dtype), config), mdcs.skeletonize(whole, config), 1e-9)


def test_float32_far_from_the_origin_keeps_its_three_ends() -> None:
    """At 1e6 a float32 has a step of 0.06; the shape is 20 wide."""
    found = run((Y * 10 + 1e6).astype(np.float32))
    assert found.summary()["cycles"] == 0
    assert found.summary()["leaves"] == 3


# --- what is no cloud


@each_config
@pytest.mark.parametrize(
    ("points", "said"),
    [
        (Y[:, :2], r"shape \(N, 3\)\n  received: shape \(1212, 2\)"),
        (Y.T.copy(), r"received: shape \(3, 1212\)"),
        (np.column_stack([Y, Y[:, 0]]), r"received: shape \(1212, 4\)"),
        (Y.ravel(), r"received: shape \(3636,\)"),
        (Y[None], r"received: shape \(1, 1212, 3\)"),
        (np.array(3.0), r"received: shape \(\)"),
        ([], r"received: shape \(0,\)"),
        (Y.astype(object), "must hold real numbers\n  received: ndarray of dtype object"),
        (Y.astype(str), "must hold real numbers"),
        (Y.astype(complex), "dtype complex128"),
        (np.zeros((5, 3), "M8[s]"), "dtype datetime64"),
        ("cloud.ply", "must hold real numbers\n  received: str"),
        (b"cloud", "must hold real numbers"),
        ([[1, 2, 3], [4, 5]], "points is not an array"),
        ({1.0, 2.0}, "must hold real numbers\n  received: set"),
        (object(), "must hold real numbers\n  received: object"),
        (None, "nothing was given for the source 'cloud'"),
        (np.ma.masked_greater(Y, 0.5), "points holds masked values"),
    ],
)
def test_what_is_no_cloud_is_refused(points: Any, said: str, config: str) -> None:
    error = refused(points, said, config)
    assert "cloud" in str(error)
