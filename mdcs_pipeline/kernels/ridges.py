"""Limbs of a cloud whose noise hides their surface: ridges of its smoothed density.

Where noise is a good part of the radius, no patch has a normal, so no ball that touches it has a
centre. But points still crowd about their limb's axis: a tube of radius r with Gaussian noise,
smoothed with a bandwidth h near r, is densest along its axis. Mean shift across the ridge takes
each point there. Limbs side by side blur into one such ridge where h is as wide as the gap; so
places climb again, on the density of the mass that pieces of limbs explain, which is sharper.

How wide h must be shows in the ridge itself. The smallest eigenvalue λ of the weighted covariance
there, over h², is small as long as h is larger than the limb is thick, and rises to that of a
window that is filled evenly as h falls. It passes a certain value at a certain part of r, with
noise of up to half the radius as without, and beside other limbs as alone: of two that lie side by
side, the ridge between them is no thicker than either. Few points show it too thin, and ever fewer
are in the window as h falls, so that a thin limb would never close; λ is what many would show.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from mdcs_pipeline.kernels.compiled.grid import Grid, grid_of, standing_for
from mdcs_pipeline.kernels.compiled.ridge import climbed, closing_scales
from mdcs_pipeline.kernels.compiled.spreading import spread_minimum
from mdcs_pipeline.kernels.limbs import BLUR, Pieces, blurred_tubes, explained_mass
from mdcs_pipeline.kernels.saddles import off_saddles
from mdcs_pipeline.kernels.thinning import merged
from mdcs_pipeline.kernels.workers import shared_out

__all__ = ["RidgeRule", "Ridges", "levelled", "ridges", "surface_noise"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Bandwidths that are looked at, falling, in the first estimate of the radius.
_FACTORS = 1.75 * 1.2 ** -np.arange(9.0)
# The bandwidth that closes, in radii: from tubes with and without noise.
_WINDOW = 0.82
# Distance within which points pull as one, in radii.
_THINNED = 0.25
# Fewer places whose window closed than this show nothing.
_LEAST = 3
# About a probe, in bandwidths.
_ABOUT = 1.0
# Places that show whether a cloud is noisy, and points about each at most.
_PROBES, _SHOWN = 40, 12
# What limbs explain: distance and length of pieces in radii, and turns of transport.
_APART, _PIECE, _TURNS = 0.2, 0.8, 30
# How often places climb on that, and the bandwidth, in the one before.
_ROUNDS, _SHARPER = 2, 0.7


class RidgeRule(NamedTuple):
    """How ridges are found.

    Parameters
    ----------
    closed : float
        Smallest eigenvalue over h², as many points would show it, at which a window is as wide as
        its limb.
    coarse : float
        Points this near to another, in local radii, have its ridge.
    starts : float
        The same for points where scales are sought.
    near : int
        Scales of so many starts are asked for their median.
    slope : float
        The bandwidth grows at most by this for every unit of distance along the surface.
    """

    closed: float = 0.77
    coarse: float = 0.15
    starts: float = 0.5
    near: int = 15
    slope: float = 0.3


class Ridges(NamedTuple):
    """Where the ridges are that points belong to.

    Parameters
    ----------
    places : (n, 3) float64
    axes : (n, 3) float64
        Direction of the ridge there; its sign means nothing.
    radius : (n,) float64
        Of the limb, without the noise.
    """

    places: FloatArray
    axes: FloatArray
    radius: FloatArray


class _Cloud(NamedTuple):
    """Points that climb, and the fewer that pull them, in the order of a grid."""

    points: FloatArray
    mass: FloatArray
    radius: FloatArray
    pulling: Grid
    pull: FloatArray


def surface_noise(
    points: FloatArray, mass: FloatArray, radius: FloatArray, rule: RidgeRule
) -> float:
    """Return how thick the surface is: the spread of distances from the ridge, in the radius.

    The median over a few places that are spread over the cloud; 0 where hardly any shows a scale.

    Parameters
    ----------
    points : (n, 3) float64
    mass : (n,) float64
    radius : (n,) float64
        First estimate of the local radius, positive.
    rule : RidgeRule
    """
    few, _, _ = _fewer(points, mass, radius, rule.coarse)
    starts, _ = standing_for(few.points, rule.starts * few.radius)
    probes = starts[np.linspace(0, len(starts) - 1, min(_PROBES, len(starts))).astype(np.int64)]
    scale = _scales(few, probes, rule.closed)
    probes, scale = probes[np.isfinite(scale)], scale[np.isfinite(scale)]
    if len(probes) < _LEAST:
        return 0.0
    around = cKDTree(few.points).query_ball_point(few.points[probes], _ABOUT * scale)
    shown = [np.asarray(near)[:: 1 + len(near) // _SHOWN] for near in around]
    each, every = np.repeat(np.arange(len(shown)), [len(s) for s in shown]), np.concatenate(shown)
    places, _ = _climbed(few, few.points[every], scale[each])
    away = np.linalg.norm(few.points[every] - places, axis=1) / scale[each] * _WINDOW
    return float(np.median([np.std(away[each == k]) for k in range(len(shown))]))


def ridges(
    points: FloatArray,
    mass: FloatArray,
    radius: FloatArray,
    graph: sparse.csr_array,
    rule: RidgeRule,
) -> Ridges | None:
    """Return the ridge that each point belongs to, or nothing where no scale shows.

    Parameters
    ----------
    points : (n, 3) float64
    mass : (n,) float64
    radius : (n,) float64
        First estimate of the local radius, positive; it may be off by half.
    graph : csr_array, (n, n)
        Distances between neighbours.
    rule : RidgeRule

    Returns
    -------
    Ridges or None
    """
    few, chosen, stands = _fewer(points, mass, radius, rule.coarse)
    reach = _reaches(few, rule)
    if reach is None:
        return None
    whole = reach[stands]
    reach = spread_minimum(graph.indptr, graph.indices, graph.data, whole, rule.slope)[0][chosen]
    places, axes = _sharpened(few, *_climbed(few, few.points, reach), reach)
    return Ridges(places[stands], axes[stands], reach[stands] / _WINDOW)


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


def _thinned(points: FloatArray, mass: FloatArray, radius: FloatArray) -> tuple[Grid, FloatArray]:
    """Return centres of mass of points that are near each other, and their masses."""
    joined = merged(points, mass, standing_for(points, _THINNED * radius)[1])
    grid = grid_of(joined.centroids, float(np.median(radius)))
    return grid, joined.weights[grid.order]


def _fewer(
    points: FloatArray, mass: FloatArray, radius: FloatArray, coarse: float
) -> tuple[_Cloud, IntArray, IntArray]:
    """Return the points that stand for all, which they are, and which stands for each."""
    chosen, stands = standing_for(points, coarse * radius)
    held = np.bincount(stands, mass).astype(np.float64)
    few = _Cloud(points[chosen], held, radius[chosen], *_thinned(points, mass, radius))
    return few, chosen, stands


def _scales(few: _Cloud, which: IntArray, closed: float) -> FloatArray:
    """Return the bandwidth that closes at some of the points; not a number where none does."""
    given = few.pulling, few.pull, few.points, few.radius, _FACTORS, closed
    return np.asarray(shared_out(lambda some: (closing_scales(*given, some),), which)[0])


def _reaches(few: _Cloud, rule: RidgeRule) -> FloatArray | None:
    """Return the bandwidth at each point, the median of those that close around it."""
    starts, _ = standing_for(few.points, rule.starts * few.radius)
    scale = _scales(few, starts, rule.closed)
    closed = np.isfinite(scale)
    count = min(rule.near, int(np.count_nonzero(closed)))
    if count < min(rule.near, _LEAST):
        return None
    tree = cKDTree(few.points[starts[closed]])
    _, around = tree.query(few.points, [*range(1, count + 1)])
    return np.asarray(np.median(scale[closed][around], axis=1), dtype=np.float64)


def _climbed(few: _Cloud, starts: FloatArray, reach: FloatArray) -> tuple[FloatArray, FloatArray]:
    given = few.pulling, few.pull, starts, reach
    places, axes = shared_out(lambda some: climbed(*given, some), np.arange(len(reach)))
    return places, axes


def _sharpened(
    few: _Cloud, places: FloatArray, axes: FloatArray, reach: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return places and axes that have climbed again, now the density of what limbs explain.

    Between two limbs some points climb onto the saddle. As a piece of limb it explains little that
    its neighbours do not, so that it loses its pull; and its points leave it for those neighbours.
    """
    for _ in range(_ROUNDS):
        chosen, _ = standing_for(places, _APART / _WINDOW * reach)
        pieces = Pieces(places[chosen], axes[chosen], reach[chosen] / _WINDOW)
        density = blurred_tubes(few.points, pieces, BLUR, _PIECE)
        held = explained_mass(density, few.mass, _TURNS)
        grid = grid_of(pieces.places, float(np.median(reach)))
        sharp = few._replace(pulling=grid, pull=held[grid.order])
        places, ways = _climbed(sharp, places, _SHARPER * reach)
        axes = np.where(ways.any(axis=1, keepdims=True), ways, axes)
        explained = sparse.csr_array(density.multiply(held[None]))
        crowd = grid, sharp.pull
        places, axes = off_saddles(
            few.points, places, axes, reach / _WINDOW, pieces, explained, crowd
        )
    return places, axes
