"""Ridges of the smoothed density of points: where it is highest across a line.

At a place x the points y_j weigh w_j = m_j exp(−‖y_j − x‖²/2h²). Their mean is the step of mean
shift, and the Hessian of the log density is (C − h² 1)/h⁴ with their covariance C: the axis of C's
largest eigenvalue is the ridge's direction, and a step across it climbs onto the ridge.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.grid import Grid, within
from mdcs_pipeline.kernels.compiled.symmetric import principal
from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray

# Bandwidths within which points count; a step of mean shift falls short of the ridge by a third.
_WINDOW, _RELAXED = 2.5, 1.3
# Steps at most, and the length, in bandwidths, of one after which there is no other.
_STEPS, _SETTLED = 20, 0.02
# The smallest eigenvalue of n points' covariance falls short by this over √n: from tubes whose
# windows hold 13 to 350 points. Below four points there is no telling.
_SHORT, _LEAST = 1.35, 0.3


@njit(cache=True, nogil=True)
def _weighed(
    grid: Grid,
    mass: FloatArray,
    place: FloatArray,
    reach: float,
    found: IntArray,
    mean: FloatArray,
    moments: FloatArray,
) -> tuple[float, float]:
    """Write mean, from the place, and covariance of the points as they weigh there, if any do.

    Return the sum of their weights and that of its squares.
    """
    points, fall = grid.points, 0.5 / (reach * reach)
    total, squares, m0, m1, m2 = 0.0, 0.0, 0.0, 0.0, 0.0
    xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in found[: within(grid, place, _WINDOW * reach, found)]:
        x, y, z = points[k, 0] - place[0], points[k, 1] - place[1], points[k, 2] - place[2]
        w = mass[k] * np.exp(-(x * x + y * y + z * z) * fall)
        total += w
        squares += w * w
        m0 += w * x
        m1 += w * y
        m2 += w * z
        xx += w * x * x
        xy += w * x * y
        xz += w * x * z
        yy += w * y * y
        yz += w * y * z
        zz += w * z * z
    if total <= 0.0:
        return 0.0, 0.0
    m0, m1, m2 = m0 / total, m1 / total, m2 / total
    mean[0], mean[1], mean[2] = m0, m1, m2
    moments[0, 0], moments[1, 1] = xx / total - m0 * m0, yy / total - m1 * m1
    moments[2, 2] = zz / total - m2 * m2
    moments[0, 1] = moments[1, 0] = xy / total - m0 * m1
    moments[0, 2] = moments[2, 0] = xz / total - m0 * m2
    moments[1, 2] = moments[2, 1] = yz / total - m1 * m2
    return total, squares


@njit(cache=True, nogil=True)
def _climb(
    grid: Grid,
    mass: FloatArray,
    place: FloatArray,
    reach: float,
    found: IntArray,
    axis: FloatArray,
) -> float:
    """Move a place onto its ridge, write the ridge's axis, and return how thin it is there.

    That is the smallest eigenvalue of C over h², as it would be if there were points enough.
    """
    mean, values = np.zeros(3), np.zeros(3)
    moments, vectors = np.zeros((3, 3)), np.zeros((3, 3))
    count = 0.0
    for _ in range(_STEPS):
        total, squares = _weighed(grid, mass, place, reach, found, mean, moments)
        if total <= 0.0:
            break
        # Masses of pieces fall by powers in transport: of what is left the squares may be nothing.
        count = total * total / squares if squares > 0.0 else 1.0
        principal(moments, values, vectors)
        along = mean[0] * vectors[0, 2] + mean[1] * vectors[1, 2] + mean[2] * vectors[2, 2]
        squared = 0.0
        for a in range(3):
            step = mean[a] - along * vectors[a, 2]
            squared += step * step
            place[a] += _RELAXED * step
        if squared < (_SETTLED * reach) ** 2:
            break
    axis[:] = vectors[:, 2]
    shown = max(1.0 - _SHORT / np.sqrt(max(count, 1.0)), _LEAST)
    return float(values[0] / (reach * reach) / shown)


@njit(cache=True, nogil=True)
def climbed(
    grid: Grid, mass: FloatArray, starts: FloatArray, reach: FloatArray, which: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return where some of the starts come to lie on ridges, and the ridges' axes.

    Parameters
    ----------
    grid : Grid
    mass : (n,) float64
        In the grid's order.
    starts : (m, 3) float64
    reach : (m,) float64
        h, the bandwidth at each.
    which : (k,) int64

    Returns
    -------
    places, axes : (k, 3) float64
    """
    places, axes = starts[which], np.zeros((len(which), 3))
    found = np.empty(len(grid.points), np.int64)
    for at in range(len(which)):
        _climb(grid, mass, places[at], reach[which[at]], found, axes[at])
    return places, axes


@njit(cache=True, nogil=True)
def windows(
    grid: Grid, mass: FloatArray, places: FloatArray, reach: FloatArray, which: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return what windows hold at some of the places, and how far it is spread.

    Parameters
    ----------
    grid : Grid
    mass : (n,) float64
        In the grid's order.
    places : (m, 3) float64
    reach : (m,) float64
        h, the bandwidth at each.
    which : (k,) int64

    Returns
    -------
    held : (k,) float64
        Mass, as it weighs there.
    spread : (k,) float64
        Largest eigenvalue of C over h²: over 1 where there is more on both sides than between.
    """
    mean, values = np.zeros(3), np.zeros(3)
    moments, vectors = np.zeros((3, 3)), np.zeros((3, 3))
    held, spread = np.zeros(len(which)), np.zeros(len(which))
    found = np.empty(len(grid.points), np.int64)
    for at in range(len(which)):
        place, h = places[which[at]], reach[which[at]]
        held[at], _ = _weighed(grid, mass, place, h, found, mean, moments)
        if held[at] > 0.0:
            principal(moments, values, vectors)
            spread[at] = values[2] / (h * h)
    return held, spread


@njit(cache=True, nogil=True)
def closing_scales(
    grid: Grid,
    mass: FloatArray,
    starts: FloatArray,
    radius: FloatArray,
    factors: FloatArray,
    closed: float,
    which: IntArray,
) -> FloatArray:
    """Return the largest bandwidth at which the ridge above each start is as thick as its window.

    Parameters
    ----------
    grid : Grid
    mass : (n,) float64
        In the grid's order.
    starts : (m, 3) float64
    radius : (m,) float64
        First estimate of the local radius.
    factors : (f,) float64
        Bandwidths to look at, falling, in that radius.
    closed : float
        Smallest eigenvalue of C, over h², from which it is.
    which : (k,) int64

    Returns
    -------
    (k,) float64
        Interpolated in its logarithm; not a number where none of the factors will do.
    """
    result, found = np.full(len(which), np.nan), np.empty(len(grid.points), np.int64)
    place, axis = np.zeros(3), np.zeros(3)
    for at in range(len(which)):
        i, before = which[at], 0.0
        for f in range(len(factors)):
            place[:] = starts[i]
            thin = _climb(grid, mass, place, factors[f] * radius[i], found, axis)
            if thin >= closed:
                part, larger = 1.0, factors[max(f - 1, 0)]
                if f > 0:
                    part = (closed - before) / (thin - before)
                result[at] = radius[i] * larger * (factors[f] / larger) ** part
                break
            before = thin
    return result
