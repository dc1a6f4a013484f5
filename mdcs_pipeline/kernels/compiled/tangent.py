"""What the surface does around each point: its normal, its bend, how its neighbours scatter.

All arrays are in the order of a `Grid`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.grid import Grid, within
from mdcs_pipeline.kernels.compiled.selecting import FEW, LANES, median_of
from mdcs_pipeline.kernels.compiled.symmetric import principal
from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray

# The ring in which the surface's bend shows, in local radii.
_INNER, RING = 0.4, 1.2
# A point at distance l stands l²/2r above or below a limb's surface; much more is another limb.
_STEEPEST = 0.7
# A patch of too few points grows by quarters, this often at most.
_GROWTHS = 8
# Fewer places than this lie on a line by chance.
_TELLING = 4
#: Under every cosine, for `medians_alike`: those of opposite normals are rounded to either side
#: of −1.
ANY = -2.0


@njit(cache=True, nogil=True)
def _moments(
    points: FloatArray,
    mass: FloatArray,
    near: IntArray,
    origin: FloatArray,
    mean: FloatArray,
    moments: FloatArray,
) -> None:
    """Write the mean, from an origin, and the covariance of some of the points."""
    total, m0, m1, m2 = 0.0, 0.0, 0.0, 0.0
    for k in near:
        w = mass[k]
        total += w
        m0 += w * (points[k, 0] - origin[0])
        m1 += w * (points[k, 1] - origin[1])
        m2 += w * (points[k, 2] - origin[2])
    share = 1.0 / total
    mean[0], mean[1], mean[2] = m0 * share, m1 * share, m2 * share
    c0, c1, c2 = origin[0] + mean[0], origin[1] + mean[1], origin[2] + mean[2]
    xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in near:
        w = mass[k] * share
        x, y, z = points[k, 0] - c0, points[k, 1] - c1, points[k, 2] - c2
        xx += w * x * x
        xy += w * x * y
        xz += w * x * z
        yy += w * y * y
        yz += w * y * z
        zz += w * z * z
    moments[0, 0], moments[1, 1], moments[2, 2] = xx, yy, zz
    moments[0, 1] = moments[1, 0] = xy
    moments[0, 2] = moments[2, 0] = xz
    moments[1, 2] = moments[2, 1] = yz


@njit(cache=True, nogil=True)
def patch_planes(
    grid: Grid, mass: FloatArray, reach: FloatArray, least: int, which: IntArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return normal, height above the middle, spread and width of points' patches.

    Parameters
    ----------
    grid : Grid
    mass : (n,) float64
    reach : (n,) float64
        Radius of each patch.
    least : int
        Points of a patch at least: where there are fewer it grows, up to six times.
    which : (k,) int64, optional
        The points that are asked for; all when absent.

    Returns
    -------
    normals : (k, 3) float64
        Unit; their signs mean nothing.
    heights : (k,) float64
        Of the point above the plane of its patch, along the normal.
    spreads : (k, 2) float64
        Standard deviation of the patch along the normal, and along its next thinnest direction.
    widths : (k,) float64
        Radius of the patch.
    """
    n = len(grid.points)
    asked = np.arange(n) if which is None else which
    count = len(asked)
    normals, heights = np.zeros((count, 3)), np.zeros(count)
    spreads, widths = np.zeros((count, 2)), np.zeros(count)
    found = np.empty(n, np.int64)
    mean, moments, values, vectors = np.empty(3), np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    for at in range(count):
        here, wide = grid.points[asked[at]], reach[asked[at]]
        near = within(grid, here, wide, found)
        for _ in range(_GROWTHS):
            if near >= min(least, n):
                break
            wide *= 1.25
            near = within(grid, here, wide, found)
        _moments(grid.points, mass, found[:near], here, mean, moments)
        principal(moments, values, vectors)
        for a in range(3):
            normals[at, a] = vectors[a, 0]
            heights[at] -= mean[a] * vectors[a, 0]
        for a in range(2):
            spreads[at, a] = np.sqrt(max(values[a], 0.0))
        widths[at] = wide
    return normals, heights, spreads, widths


@njit(cache=True, nogil=True)
def bends(
    grid: Grid, normals: FloatArray, radius: FloatArray, which: IntArray | None = None
) -> FloatArray:
    """Return how far the surface around points falls away from their normals, in radii.

    The mean over a ring about as wide as the limb: positive where the normal points outwards,
    for a limb bends around itself more than it bends along. For all points, or `which`.
    """
    n = len(grid.points)
    asked = np.arange(n) if which is None else which
    result, found = np.zeros(len(asked)), np.empty(n, np.int64)
    points = grid.points
    for at in range(len(asked)):
        i = asked[at]
        here, normal, r = points[i], normals[i], radius[i]
        inner, total, count = (_INNER * r) ** 2, 0.0, 0
        for k in found[: within(grid, here, RING * r, found)]:
            x, y, z = points[k, 0] - here[0], points[k, 1] - here[1], points[k, 2] - here[2]
            away = x * x + y * y + z * z
            height = x * normal[0] + y * normal[1] + z * normal[2]
            if away > inner and abs(height) <= _STEEPEST * away / r:
                total -= height
                count += 1
        result[at] = total / (r * max(count, 1))
    return result


@njit(cache=True, nogil=True)
def medians_alike(
    grid: Grid,
    normals: FloatArray,
    reach: FloatArray,
    values: FloatArray,
    cosine: float,
    which: IntArray | None = None,
) -> FloatArray:
    """Return the median of `values` over points' patches, where these face the same way.

    For all points, or `which`.
    """
    n = len(grid.points)
    asked = np.arange(n) if which is None else which
    result, found = np.empty(len(asked)), np.empty(n, np.int64)
    held, ranks = np.empty(n + LANES), np.empty(FEW + LANES, np.int64)
    for at in range(len(asked)):
        i = asked[at]
        held[0], count = values[i], 1
        n0, n1, n2 = normals[i, 0], normals[i, 1], normals[i, 2]
        for k in found[: within(grid, grid.points[i], reach[i], found)]:
            if k == i:
                continue
            held[count] = values[k]
            count += n0 * normals[k, 0] + n1 * normals[k, 1] + n2 * normals[k, 2] > cosine
        result[at] = median_of(held, count, ranks)
    return result


@njit(cache=True, nogil=True)
def scatters(
    grid: Grid, reach: FloatArray, places: FloatArray, which: IntArray | None = None
) -> FloatArray:
    """Return how far the places that belong to each point's patch lie from their common line.

    Parameters
    ----------
    grid : Grid
    reach : (n,) float64
        Radius of each patch.
    places : (n, 3) float64
    which : (k,) int64, optional
        The points that are asked for; all when absent.

    Returns
    -------
    (k,) float64
        Root mean square distance; infinite where a patch has too few points to tell.
    """
    n = len(places)
    asked = np.arange(n) if which is None else which
    result, found, even = np.full(len(asked), np.inf), np.empty(n, np.int64), np.ones(n)
    mean, moments, values, vectors = np.empty(3), np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    for at in range(len(asked)):
        i = asked[at]
        count = within(grid, grid.points[i], reach[i], found)
        if count >= _TELLING:
            _moments(places, even, found[:count], places[i], mean, moments)
            principal(moments, values, vectors)
            result[at] = np.sqrt(max(values[0] + values[1], 0.0))
    return result


@njit(cache=True, nogil=True)
def agreed(
    indptr: IntArray,
    indices: IntArray,
    normals: FloatArray,
    own: FloatArray,
    share: float,
    rounds: int,
    which: IntArray,
) -> FloatArray:
    """Return what points say after rounds in which each listens to its neighbours.

    s_i ← share · own_i + (1 − share) Σ_j c_ij |c_ij| clip(s_j, −1, 1) / Σ_j c_ij², with the
    cosines c_ij of the normals at both ends of a link (CSR). Only those of `which` listen; the
    others say what they did.
    """
    n = len(own)
    weights, total = np.empty(len(indices)), np.empty(n)
    # Of numbers without a sign none is looked at for counting from the end.
    starts, ends = indptr.astype(np.uint64), indices.astype(np.uint32)
    for i in which:
        squares = 0.0
        for e in range(starts[i], starts[i + 1]):
            j, cosine = ends[e], 0.0
            for a in range(3):
                cosine += normals[i, a] * normals[j, a]
            weights[e] = cosine * abs(cosine)
            squares += cosine * cosine
        total[i] = max(squares, 1e-9)
    said, heard = own.copy(), np.empty(n)
    for _ in range(rounds):
        for k in range(n):
            heard[k] = min(max(said[k], -1.0), 1.0)
        for i in which:
            lent = 0.0
            for e in range(starts[i], starts[i + 1]):
                lent += weights[e] * heard[ends[e]]
            said[i] = share * own[i] + (1.0 - share) * lent / total[i]
    return said
