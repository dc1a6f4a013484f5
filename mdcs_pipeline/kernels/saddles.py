"""Saddles: places between limbs, from where mean shift across the axis does not lead to either.

On a saddle the axis points from limb to limb, so that the density rises along it both ways. It
does so, too, where two limbs meet at a junction; but what joins them there holds as much as they
do. A place between limbs holds less, and transport says which limb explains its point.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.compiled.grid import Grid
from mdcs_pipeline.kernels.compiled.ridge import windows
from mdcs_pipeline.kernels.limbs import Pieces
from mdcs_pipeline.kernels.workers import shared_out

__all__ = ["off_saddles"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Distance, in radii, beside the axis of what explains a point, from which a place is not on it,
# and how far along its piece places go.
_BESIDE, _ALONG = 0.5, 0.4
# Windows, in radii, that tell how mass is spread and how much there is.
_SPREAD_IN, _HELD_IN = 1.0, 0.7
# Spread in h² above which mass lies on both sides; share of the limb's mass below which a place
# is between limbs.
_SPREAD, _HOLLOW = 1.2, 0.5


def off_saddles(
    points: FloatArray,
    places: FloatArray,
    axes: FloatArray,
    radius: FloatArray,
    pieces: Pieces,
    explained: sparse.csr_array,
    crowd: tuple[Grid, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Return places and axes, those on saddles on the piece of limb that explains their points.

    Parameters
    ----------
    points : (n, 3) float64
    places, axes : (n, 3) float64
        Where the points have climbed to, and the ridges' axes there.
    radius : (n,) float64
    pieces : Pieces
        Of limbs, m of them.
    explained : csr_array, (n, m)
        Mass that each piece explains of each point, up to a factor for the point.
    crowd : tuple of Grid and (m,) float64
        The pieces' places and masses, in the grid's order.

    Returns
    -------
    places, axes : (n, 3) float64
    """
    own = np.asarray(explained.argmax(axis=1)).ravel()
    way, half = pieces.axes[own], _ALONG * pieces.radius[own]
    along = ((points - pieces.places[own]) * way).sum(axis=1)
    onto = pieces.places[own] + np.clip(along, -half, half)[:, None] * way
    gap = places - onto
    across = np.linalg.norm(gap - (gap * way).sum(axis=1)[:, None] * way, axis=1)
    beside = np.flatnonzero((np.diff(explained.indptr) > 0) & (across > _BESIDE * radius))
    spread = _held(crowd, places, _SPREAD_IN * radius, beside)[1]
    between = beside[spread > _SPREAD]
    here = _held(crowd, places, _HELD_IN * radius, between)[0]
    there = _held(crowd, onto, _HELD_IN * radius, between)[0]
    saddle = between[here < _HOLLOW * there]
    places, axes = places.copy(), axes.copy()
    places[saddle], axes[saddle] = onto[saddle], way[saddle]
    return places, axes


def _held(
    crowd: tuple[Grid, FloatArray], places: FloatArray, reach: FloatArray, which: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the mass in windows at some of the places, and its spread."""
    grid, mass = crowd
    held, spread = shared_out(lambda some: windows(grid, mass, places, reach, some), which)
    return held, spread
