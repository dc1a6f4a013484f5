"""Places between two limbs: they leave for the limb that explains their point, a rung's stay."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.compiled.grid import Grid, grid_of
from mdcs_pipeline.kernels.limbs import Pieces
from mdcs_pipeline.kernels.saddles import off_saddles

FloatArray = NDArray[np.float64]

R = 0.1
GAP = 2.4 * R
ALONG, UP = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])


def rails(rung: bool) -> Pieces:
    """Return two limbs along x that lie side by side, and perhaps one from axis to axis."""
    x = np.arange(-5, 6) * 0.2 * R
    rows = [np.stack([x, np.full(11, y), np.zeros(11)], axis=1) for y in (0.0, GAP)]
    axes = [np.tile(ALONG, (22, 1))]
    if rung:
        y = np.arange(1, 12) * GAP / 12
        rows.append(np.stack([np.zeros(11), y, np.zeros(11)], axis=1))
        axes.append(np.tile(UP, (11, 1)))
    places = np.concatenate(rows)
    return Pieces(places, np.concatenate(axes), np.full(len(places), R))


def crowd(pieces: Pieces, mass: FloatArray) -> tuple[Grid, FloatArray]:
    grid = grid_of(pieces.places, R)
    return grid, mass[grid.order]


def moved(
    point: FloatArray, place: FloatArray, axis: FloatArray, pieces: Pieces
) -> tuple[FloatArray, FloatArray]:
    """Return where one place goes whose point is explained by what it is nearest to."""
    away = np.linalg.norm(pieces.places - point, axis=1)
    explained = sparse.csr_array(np.exp(-0.5 * (away / R) ** 2)[None])
    places, axes = off_saddles(
        point[None],
        place[None],
        axis[None],
        np.full(1, R),
        pieces,
        explained,
        crowd(pieces, np.ones(len(pieces.places))),
    )
    return places[0], axes[0]


MIDDLE = np.array([0.01 * R, 0.5 * GAP, 0.0])
# On the far side of the upper limb, and half a piece along it.
POINT = np.array([0.07 * R, GAP + 0.8 * R, 0.0])


def test_a_place_between_two_limbs_goes_to_that_of_its_point() -> None:
    place, axis = moved(POINT, MIDDLE, UP, rails(rung=False))
    np.testing.assert_allclose(place, [0.07 * R, GAP, 0.0], atol=1e-12)
    np.testing.assert_array_equal(axis, ALONG)


def test_a_place_on_a_rung_stays() -> None:
    """Its axis leads from limb to limb, too; but it holds as much as they do."""
    place, axis = moved(POINT, MIDDLE, UP, rails(rung=True))
    np.testing.assert_array_equal(place, MIDDLE)
    np.testing.assert_array_equal(axis, UP)


def test_a_place_on_the_limb_of_its_point_stays() -> None:
    here = np.array([0.3 * R, GAP - 0.4 * R, 0.0])
    place, _ = moved(POINT, here, ALONG, rails(rung=False))
    np.testing.assert_array_equal(place, here)


def test_a_place_whose_point_nothing_explains_stays() -> None:
    pieces = rails(rung=False)
    nothing = sparse.csr_array((1, len(pieces.places)))
    given = POINT[None], MIDDLE[None], UP[None], np.full(1, R)
    places, _ = off_saddles(*given, pieces, nothing, crowd(pieces, np.ones(22)))
    np.testing.assert_array_equal(places[0], MIDDLE)


def test_the_callers_arrays_stay_as_they_are() -> None:
    pieces, place = rails(rung=False), MIDDLE.copy()
    moved(POINT, place, UP, pieces)
    np.testing.assert_array_equal(place, MIDDLE)
