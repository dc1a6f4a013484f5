"""What the surface does around each point: its normal, its bend, the ball that it lies on.

All arrays are in the order of a `Grid`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.grid import Grid, within
from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray

# The ring in which the surface's bend shows, in local radii.
_INNER, _OUTER = 0.4, 1.2
# A point at distance l stands l²/2r above or below a limb's surface; much more is another limb.
_STEEPEST = 0.7
# A patch of too few points grows by quarters, this often at most.
_GROWTHS = 8
# Fewer places than this lie on a line by chance.
_TELLING = 4


@njit(cache=True, nogil=True)
def _moments(
    points: FloatArray, mass: FloatArray, near: IntArray, origin: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the mean, from an origin, and the covariance of some of the points."""
    total, mean = 0.0, np.zeros(3)
    for k in near:
        total += mass[k]
        for a in range(3):
            mean[a] += mass[k] * (points[k, a] - origin[a])
    mean /= total
    moments, offset = np.zeros((3, 3)), np.empty(3)
    for k in near:
        for a in range(3):
            offset[a] = points[k, a] - origin[a] - mean[a]
        for a in range(3):
            for b in range(3):
                moments[a, b] += mass[k] / total * offset[a] * offset[b]
    return mean, moments


@njit(cache=True, nogil=True)
def patch_planes(
    grid: Grid, mass: FloatArray, reach: FloatArray, least: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return normal, height above the middle, spread and width of each point's patch.

    Parameters
    ----------
    grid : Grid
    mass : (n,) float64
    reach : (n,) float64
        Radius of each patch.
    least : int
        Points of a patch at least: where there are fewer it grows, up to six times.

    Returns
    -------
    normals : (n, 3) float64
        Unit; their signs mean nothing.
    heights : (n,) float64
        Of the point above the plane of its patch, along the normal.
    spreads : (n, 2) float64
        Standard deviation of the patch along the normal, and along its next thinnest direction.
    widths : (n,) float64
        Radius of the patch.
    """
    n = len(grid.points)
    normals, heights, spreads, widths = (
        np.zeros((n, 3)),
        np.zeros(n),
        np.zeros((n, 2)),
        reach.copy(),
    )
    found = np.empty(n, np.int64)
    for i in range(n):
        here, wide = grid.points[i], reach[i]
        count = within(grid, here, wide, found)
        for _ in range(_GROWTHS):
            if count >= min(least, n):
                break
            wide *= 1.25
            count = within(grid, here, wide, found)
        mean, moments = _moments(grid.points, mass, found[:count], here)
        values, vectors = np.linalg.eigh(moments)
        normals[i] = vectors[:, 0]
        heights[i] = -np.dot(mean, vectors[:, 0])
        for a in range(2):
            spreads[i, a] = np.sqrt(max(values[a], 0.0))
        widths[i] = wide
    return normals, heights, spreads, widths


@njit(cache=True, nogil=True)
def bends(grid: Grid, normals: FloatArray, radius: FloatArray) -> FloatArray:
    """Return how far the surface around each point falls away from its normal, in radii.

    The mean over a ring about as wide as the limb: positive where the normal points outwards,
    for a limb bends around itself more than it bends along.
    """
    n = len(grid.points)
    result, found = np.zeros(n), np.empty(n, np.int64)
    for i in range(n):
        here = grid.points[i]
        inner, total, count = (_INNER * radius[i]) ** 2, 0.0, 0
        for k in found[: within(grid, here, _OUTER * radius[i], found)]:
            away, height = 0.0, 0.0
            for a in range(3):
                step = grid.points[k, a] - here[a]
                away += step * step
                height += step * normals[i, a]
            if away > inner and abs(height) <= _STEEPEST * away / radius[i]:
                total -= height
                count += 1
        result[i] = total / (radius[i] * max(count, 1))
    return result


@njit(cache=True, nogil=True)
def tangent_radii(
    grid: Grid, normals: FloatArray, most: FloatArray, apart: float, pierced: int
) -> FloatArray:
    """Return the radius of the largest ball inside that touches the surface at each point.

    The ball lies on the side that the normal turns away from. Only points that are seen from
    its centre at more than `apart` radians from where it touches limit it: what is nearer says
    how rough the sampling is.

    Parameters
    ----------
    grid : Grid
    normals : (n, 3) float64
        Unit, outwards.
    most : (n,) float64
        Largest radius.
    apart : float
    pierced : int
        Points that may lie inside: the smallest balls of all are those of noise.

    Returns
    -------
    (n,) float64
    """
    n = len(grid.points)
    result, found, least = most.copy(), np.empty(n, np.int64), np.empty(pierced + 1)
    limit = 2.0 * (1.0 - np.cos(apart))
    for i in range(n):
        here, reach = grid.points[i], 2.0 * grid.size
        while True:
            least[:] = most[i]
            # Through a point at distance l goes no ball smaller than l/2.
            reach = min(reach, 2.0 * most[i])
            for k in found[: within(grid, here, reach, found)]:
                away, depth = 0.0, 0.0
                for a in range(3):
                    step = grid.points[k, a] - here[a]
                    away += step * step
                    depth -= step * normals[i, a]
                if depth > 0.0:
                    radius = away / (2.0 * depth)
                    if radius < least[pierced] and away > limit * radius * radius:
                        at = pierced
                        while at > 0 and least[at - 1] > radius:
                            least[at] = least[at - 1]
                            at -= 1
                        least[at] = radius
            if reach >= 2.0 * least[pierced]:
                break
            reach *= 1.5
        result[i] = least[pierced]
    return result


@njit(cache=True, nogil=True)
def medians_alike(
    grid: Grid, normals: FloatArray, reach: FloatArray, values: FloatArray, cosine: float
) -> FloatArray:
    """Return the median of `values` over each point's patch, where it faces the same way."""
    n = len(grid.points)
    result, found, held = np.empty(n), np.empty(n, np.int64), np.empty(n)
    for i in range(n):
        held[0], count = values[i], 1
        for k in found[: within(grid, grid.points[i], reach[i], found)]:
            if k != i and np.dot(normals[i], normals[k]) > cosine:
                held[count] = values[k]
                count += 1
        result[i] = np.median(held[:count])
    return result


@njit(cache=True, nogil=True)
def scatters(grid: Grid, reach: FloatArray, places: FloatArray) -> FloatArray:
    """Return how far the places that belong to each point's patch lie from their common line.

    Parameters
    ----------
    grid : Grid
    reach : (n,) float64
        Radius of each patch.
    places : (n, 3) float64

    Returns
    -------
    (n,) float64
        Root mean square distance; infinite where a patch has too few points to tell.
    """
    n = len(places)
    result, found, even = np.empty(n), np.empty(n, np.int64), np.ones(n)
    for i in range(n):
        count = within(grid, grid.points[i], reach[i], found)
        _, moments = _moments(places, even, found[:count], places[i])
        values = np.linalg.eigvalsh(moments)
        result[i] = np.sqrt(max(values[0] + values[1], 0.0)) if count >= _TELLING else np.inf
    return result
