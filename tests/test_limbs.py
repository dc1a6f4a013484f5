"""Mass that pieces of limbs explain: closed forms, and which pieces it leaves."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mdcs_pipeline.kernels.limbs import Pieces, blurred_tubes, explained_mass

FloatArray = NDArray[np.float64]

X = np.array([1.0, 0.0, 0.0])


def pieces(places: FloatArray, radius: float) -> Pieces:
    return Pieces(places, np.tile(X, (len(places), 1)), np.full(len(places), radius))


def shell(rng: np.random.Generator, y: float, radius: float, noise: float, n: int) -> FloatArray:
    """Return points about a tube along x from 0 to 4 radii."""
    angle = rng.uniform(0, 2 * np.pi, n)
    along = rng.uniform(0, 4 * radius, n)
    skin = np.stack([along, y + radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    return skin + noise * radius * rng.normal(size=(n, 3))


@pytest.mark.parametrize("radius", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("blur", [0.2, 0.42])
def test_a_piece_has_the_density_of_a_blurred_cylinder(radius: float, blur: float) -> None:
    """Over all space k integrates to (2π)^(3/2), but for what is cut off."""
    step = 0.05 * radius
    side = np.arange(-3.0, 3.01, 0.05) * radius
    grid = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    density = blurred_tubes(grid, pieces(np.zeros((1, 3)), radius), blur, 0.5)
    whole = density.sum() * step**3
    np.testing.assert_allclose(whole, (2 * np.pi) ** 1.5, rtol=0.06)
    assert whole < (2 * np.pi) ** 1.5


def test_points_at_the_radius_are_likelier_than_those_inside_and_outside() -> None:
    away = np.array([[0, 0, 0], [0, 0.5, 0], [0, 1, 0], [0, 1.5, 0], [0, 5, 0]], dtype=float)
    density = blurred_tubes(away, pieces(np.zeros((1, 3)), 1.0), 0.3, 0.5).toarray().ravel()
    assert density.argmax() == 2
    assert density[4] == 0.0


def test_the_axis_of_a_piece_has_no_sign() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(50, 3))
    one = pieces(np.zeros((1, 3)), 1.0)
    there = blurred_tubes(points, one, 0.4, 0.8).toarray()
    back = blurred_tubes(points, one._replace(axes=-one.axes), 0.4, 0.8).toarray()
    np.testing.assert_array_equal(there, back)


def test_mass_near_a_piece_is_explained_by_it_and_far_mass_by_none() -> None:
    points = np.array([[0, 1, 0], [0, 0, 1], [9, 1, 0], [50, 0, 0]], dtype=float)
    two = pieces(np.array([[0.0, 0, 0], [9, 0, 0]]), 1.0)
    held = explained_mass(blurred_tubes(points, two, 0.4, 0.8), np.array([1.0, 2, 4, 8]), 5)
    np.testing.assert_allclose(held, [3.0, 4.0], rtol=1e-12)


def test_every_turn_makes_the_points_likelier() -> None:
    rng = np.random.default_rng(1)
    points, mass = shell(rng, 0.0, 1.0, 0.3, 300), rng.uniform(0.5, 1.5, 300)
    places = rng.uniform([0, -1, -1], [4, 1, 1], (20, 3))
    density = blurred_tubes(points, pieces(places, 1.0), 0.42, 0.8)
    seen = np.asarray(density.sum(axis=1)) > 0
    told = [
        mass[seen] @ np.log((density @ explained_mass(density, mass, turns))[seen])
        for turns in range(1, 12)
    ]
    assert (np.diff(told) > -1e-9).all()
    assert told[-1] > told[0] + 1.0


def test_pieces_between_two_limbs_lose_their_mass_to_those_on_the_limbs() -> None:
    rng = np.random.default_rng(2)
    points = np.concatenate([shell(rng, y, 1.0, 0.3, 1500) for y in (0.0, 2.8)])
    along = np.linspace(0.2, 3.8, 12)
    rows = [np.stack([along, np.full(12, y), np.zeros(12)], axis=1) for y in (0.0, 1.4, 2.8)]
    density = blurred_tubes(points, pieces(np.concatenate(rows), 1.0), 0.42, 0.8)
    first, between, second = explained_mass(density, np.ones(3000), 30).reshape(3, 12).sum(axis=1)
    assert between < 0.05 * min(first, second)
    np.testing.assert_allclose(first, second, rtol=0.1)


def test_no_pieces_explain_nothing() -> None:
    density = blurred_tubes(np.zeros((3, 3)), pieces(np.empty((0, 3)), 1.0), 0.42, 0.8)
    assert explained_mass(density, np.ones(3), 3).shape == (0,)
