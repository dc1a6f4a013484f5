"""Limbs of a cloud whose noise hides their surface: ridges of its smoothed density.

Where noise is a good part of the radius, no patch has a normal, so no ball that touches it has a
centre. But points still crowd about their limb's axis: a tube of radius r with Gaussian noise,
smoothed with a bandwidth h near r, is densest along its axis. Mean shift across the ridge takes
each point there.

How wide h must be shows in the ridge itself. The smallest eigenvalue λ of the weighted covariance
there, over h², is small as long as h is larger than the limb is thick, and rises to that of a
window that is filled evenly as h falls. It passes 0.68 at h = 0.84 r, with noise of up to half the
radius as without, and beside other limbs as alone: of two that lie side by side, the ridge between
them is no thicker than either.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from mdcs_pipeline.kernels.compiled.grid import Grid, covering, grid_of, scattered
from mdcs_pipeline.kernels.compiled.ridge import climbed, closing_scales, continued, sums_near
from mdcs_pipeline.kernels.compiled.spreading import spread_minimum
from mdcs_pipeline.kernels.workers import shared_out

__all__ = ["RidgeRule", "Ridges", "levelled", "ridges"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Bandwidths that are looked at, falling, in the first estimate of the radius.
_FACTORS = 1.75 * 1.2 ** -np.arange(9.0)
# The bandwidth that closes, in radii: from tubes with and without noise.
_WINDOW = 0.85
# Distance within which points pull as one, in radii.
_THINNED = 0.25
# Fewer starts that closed than this show no scale.
_LEAST = 3
# Near on a ridge, and about it, in bandwidths.
_ON, _ABOUT = 0.3, 1.0
# Up to where a ridge goes on, in bandwidths.
_ONWARD = 1.2
# Strays move no farther than this, in bandwidths: a limb of its own is none.
_FARTHEST = 1.5


class RidgeRule(NamedTuple):
    """How ridges are found.

    Parameters
    ----------
    closed : float
        Smallest eigenvalue over h² at which a window is as wide as its limb.
    coarse : float
        Points this near to another, in local radii, have its ridge.
    starts : float
        The same for points where scales are sought.
    near : int
        Scales of so many starts are asked for their median.
    slope : float
        The bandwidth grows at most by this for every unit of distance along the surface.
    stray : float
        Mass that has come close to a place, over what was around it before, below which it is no
        ridge.
    """

    closed: float = 0.68
    coarse: float = 0.15
    starts: float = 0.5
    near: int = 15
    slope: float = 0.3
    stray: float = 1.0


class Ridges(NamedTuple):
    """Where the ridges are that points belong to.

    Parameters
    ----------
    places : (n, 3) float64
    axes : (n, 3) float64
        Direction of the ridge there; its sign means nothing.
    radius : (n,) float64
        Of the limb, without the noise.
    noise : float
        Median over the cloud of the local spread of distances from the ridge, in that radius.
    """

    places: FloatArray
    axes: FloatArray
    radius: FloatArray
    noise: float


class _Cloud(NamedTuple):
    """Points that climb, and the fewer that pull them, in the order of a grid."""

    points: FloatArray
    mass: FloatArray
    radius: FloatArray
    pulling: Grid
    pull: FloatArray


def ridges(
    points: FloatArray,
    mass: FloatArray,
    graph: sparse.csr_array,
    radius: FloatArray,
    rule: RidgeRule,
) -> Ridges | None:
    """Return the ridge that each point belongs to, or nothing where no scale shows.

    Parameters
    ----------
    points : (n, 3) float64
    mass : (n,) float64
    graph : csr_array, (n, n)
        Distances between neighbours.
    radius : (n,) float64
        First estimate of the local radius, positive; it may be off by half.
    rule : RidgeRule

    Returns
    -------
    Ridges or None
    """
    chosen, stands = _spread(points, rule.coarse * radius)
    held = np.bincount(stands, mass).astype(np.float64)
    few = _Cloud(points[chosen], held, radius[chosen], *_thinned(points, mass, radius))
    reach = _reaches(few, rule)
    if reach is None:
        return None
    whole = reach[stands]
    reach = spread_minimum(graph.indptr, graph.indices, graph.data, whole, rule.slope)[0][chosen]
    places, axes = _climbed(few, reach)
    noise = _noise(few.points, places, reach)
    places, axes = _gathered(few, places, axes, reach, rule.stray)
    return Ridges(places[stands], axes[stands], reach[stands] / _WINDOW, noise)


def levelled(points: FloatArray, found: Ridges) -> FloatArray:
    """Return the points on their limbs' surfaces: as far from the ridge's axis as it is thick.

    They stay where they are along the axis. One on the axis itself has no side to go to.

    Parameters
    ----------
    points : (n, 3) float64
    found : Ridges

    Returns
    -------
    (n, 3) float64
    """
    across = points - found.places
    across = across - (across * found.axes).sum(axis=1, keepdims=True) * found.axes
    length = np.linalg.norm(across, axis=1, keepdims=True)
    outward = np.divide(across, length, out=np.zeros_like(across), where=length > 0)
    return np.asarray(points - across + found.radius[:, None] * outward, dtype=np.float64)


def _spread(points: FloatArray, apart: FloatArray) -> tuple[IntArray, IntArray]:
    """Return points that all others are near to, and which of them stands for each."""
    grid = grid_of(points, float(np.median(apart)))
    chosen, stands = covering(grid, apart[grid.order])
    return grid.order[chosen], scattered(grid, stands)


def _thinned(points: FloatArray, mass: FloatArray, radius: FloatArray) -> tuple[Grid, FloatArray]:
    """Return centres of mass of points that are near each other, and their masses."""
    _, stands = _spread(points, _THINNED * radius)
    held = np.bincount(stands, mass)
    middle = [np.bincount(stands, mass * points[:, a]) / held for a in range(3)]
    grid = grid_of(np.stack(middle, axis=1), float(np.median(radius)))
    return grid, held[grid.order].astype(np.float64)


def _reaches(few: _Cloud, rule: RidgeRule) -> FloatArray | None:
    """Return the bandwidth at each point, the median of those that close around it."""
    chosen, _ = _spread(few.points, rule.starts * few.radius)
    starts, first = few.points[chosen], few.radius[chosen]
    given = few.pulling, few.pull, starts, first, _FACTORS, rule.closed
    (scale,) = shared_out(lambda some: (closing_scales(*given, some),), np.arange(len(starts)))
    closed = np.isfinite(scale)
    count = min(rule.near, int(np.count_nonzero(closed)))
    if count < min(rule.near, _LEAST):
        return None
    _, around = cKDTree(starts[closed]).query(few.points, [*range(1, count + 1)])
    return np.asarray(np.median(scale[closed][around], axis=1), dtype=np.float64)


def _climbed(few: _Cloud, reach: FloatArray) -> tuple[FloatArray, FloatArray]:
    given = few.pulling, few.pull, few.points, reach
    places, axes = shared_out(lambda some: climbed(*given, some), np.arange(len(reach)))
    return places, axes


def _noise(points: FloatArray, places: FloatArray, reach: FloatArray) -> float:
    """Return the median of the local standard deviation of distances from the ridge, in radii."""
    away = np.linalg.norm(points - places, axis=1) / reach * _WINDOW
    sums = _sums(points, np.stack([np.ones(len(away)), away, away**2], axis=1), points, reach)
    mean, square = sums[:, 1] / sums[:, 0], sums[:, 2] / sums[:, 0]
    return float(np.median(np.sqrt(np.maximum(square - mean**2, 0.0))))


def _gathered(
    few: _Cloud, places: FloatArray, axes: FloatArray, reach: FloatArray, stray: float
) -> tuple[FloatArray, FloatArray]:
    """Return places and axes, those of strays moved to the nearest ridge.

    Between two limbs some points climb onto the saddle: little comes to lie there for all that is
    around. Little also comes to the root of a limb, but from there the limb goes on.
    """
    held = few.mass[:, None]
    now = _sums(places, held, places, _ON * reach)[:, 0]
    before = _sums(few.points, held, places, _ABOUT * reach)[:, 0]
    lost = now < stray * before
    if not lost.any() or lost.all():
        return places, axes
    asked, ridge = np.flatnonzero(lost), np.flatnonzero(~lost)
    grid = grid_of(places[ridge], float(np.median(reach)))
    given = grid, axes[ridge][grid.order], places, axes, _ONWARD * reach
    (roots,) = shared_out(lambda some: (continued(*given, some),), asked)
    away, nearest = (np.asarray(one) for one in cKDTree(places[ridge]).query(places[asked]))
    move = ~roots & (away < _FARTHEST * reach[asked])
    places, axes = places.copy(), axes.copy()
    to = ridge[nearest[move]]
    places[asked[move]], axes[asked[move]] = places[to], axes[to]
    return places, axes


def _sums(
    points: FloatArray, values: FloatArray, places: FloatArray, reach: FloatArray
) -> FloatArray:
    """Return the sums of points' values within reach of places."""
    grid = grid_of(points, float(np.median(reach)))
    given = grid, values[grid.order], places, reach
    return shared_out(lambda some: (sums_near(*given, some),), np.arange(len(places)))[0]
