"""Moments of a cloud, in passes that copy nothing of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.types import FloatArray

# Sums of so many points are added up first: a sum over 10⁷ then keeps its digits.
_RUN = 4096


# Sums are kept in variables of their own: in an array each waits for the one before to be stored.


@njit(cache=True, nogil=True)
def _origin(points: Any) -> FloatArray:
    """Return the first point, (3,); 0 where there is none."""
    origin = np.zeros(3)
    for a in range(3 if len(points) else 0):
        origin[a] = points[0, a]
    return origin


@njit(cache=True, nogil=True)
def mean_offset(points: Any, weights: Any) -> tuple[FloatArray, float]:
    """Return the weighted mean from the first point on, and the largest coordinate's size.

    `weights` may be empty: all are then 1.
    """
    total, sums, even = 0.0, np.zeros(3), len(weights) == 0
    origin = _origin(points)
    largest = 0.0
    for first in range(0, len(points), _RUN):
        r0, r1, r2, mass = 0.0, 0.0, 0.0, 0.0
        for j in range(first, min(len(points), first + _RUN)):
            w = 1.0 if even else weights[j]
            x, y, z = np.float64(points[j, 0]), np.float64(points[j, 1]), np.float64(points[j, 2])
            largest = max(largest, abs(x), abs(y), abs(z))
            mass += w
            r0 += w * (x - origin[0])
            r1 += w * (y - origin[1])
            r2 += w * (z - origin[2])
        sums[0] += r0
        sums[1] += r1
        sums[2] += r2
        total += mass
    return sums / total, largest


@njit(cache=True, nogil=True)
def covariance_about(points: Any, weights: Any, centre: FloatArray) -> FloatArray:
    """Return the weighted covariance about `centre`, (3, 3), which is taken from the first."""
    total, sums, even = 0.0, np.zeros((3, 3)), len(weights) == 0
    origin = _origin(points)
    for first in range(0, len(points), _RUN):
        xx, xy, xz, yy, yz, zz, mass = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(first, min(len(points), first + _RUN)):
            w = 1.0 if even else weights[j]
            x = np.float64(points[j, 0]) - origin[0] - centre[0]
            y = np.float64(points[j, 1]) - origin[1] - centre[1]
            z = np.float64(points[j, 2]) - origin[2] - centre[2]
            xx += w * x * x
            xy += w * x * y
            xz += w * x * z
            yy += w * y * y
            yz += w * y * z
            zz += w * z * z
            mass += w
        sums[0, 0] += xx
        sums[0, 1] += xy
        sums[0, 2] += xz
        sums[1, 1] += yy
        sums[1, 2] += yz
        sums[2, 2] += zz
        total += mass
    for a in range(3):
        for b in range(a):
            sums[a, b] = sums[b, a]
    return sums / total


@njit(cache=True, nogil=True)
def third_moments(
    points: Any, weights: Any, centre: FloatArray, axes: FloatArray, spread: float
) -> FloatArray:
    """Return the weighted mean of the cubes of the coordinates along `axes`, over `spread`."""
    total, sums, even = 0.0, np.zeros(3), len(weights) == 0
    origin = _origin(points)
    for first in range(0, len(points), _RUN):
        r0, r1, r2, mass = 0.0, 0.0, 0.0, 0.0
        for j in range(first, min(len(points), first + _RUN)):
            w = 1.0 if even else weights[j]
            x = np.float64(points[j, 0]) - origin[0] - centre[0]
            y = np.float64(points[j, 1]) - origin[1] - centre[1]
            z = np.float64(points[j, 2]) - origin[2] - centre[2]
            mass += w
            along = (axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z) / spread
            r0 += w * along * along * along
            along = (axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z) / spread
            r1 += w * along * along * along
            along = (axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z) / spread
            r2 += w * along * along * along
        sums[0] += r0
        sums[1] += r1
        sums[2] += r2
        total += mass
    return sums / total
