"""Moments of a cloud, in passes that copy nothing of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.types import FloatArray

# Sums of so many points are added up first: a sum over 10⁷ then keeps its digits.
_RUN = 4096


@njit(cache=True, nogil=True)
def mean_offset(points: Any, weights: Any) -> tuple[FloatArray, float]:
    """Return the weighted mean from the first point on, and the largest coordinate's size.

    `weights` may be empty: all are then 1.
    """
    total, sums, run = 0.0, np.zeros(3), np.zeros(4)
    largest = 0.0
    for first in range(0, len(points), _RUN):
        run[:] = 0.0
        for j in range(first, min(len(points), first + _RUN)):
            w = weights[j] if len(weights) else 1.0
            run[3] += w
            for a in range(3):
                value = np.float64(points[j, a])
                largest = max(largest, abs(value))
                run[a] += w * (value - np.float64(points[0, a]))
        sums += run[:3]
        total += run[3]
    return sums / total, largest


@njit(cache=True, nogil=True)
def covariance_about(points: Any, weights: Any, centre: FloatArray) -> FloatArray:
    """Return the weighted covariance about `centre`, (3, 3), which is taken from the first."""
    total, sums, run = 0.0, np.zeros((3, 3)), np.zeros(7)
    x = np.empty(3)
    for first in range(0, len(points), _RUN):
        run[:] = 0.0
        for j in range(first, min(len(points), first + _RUN)):
            w = weights[j] if len(weights) else 1.0
            for a in range(3):
                x[a] = np.float64(points[j, a]) - np.float64(points[0, a]) - centre[a]
            run[0] += w * x[0] * x[0]
            run[1] += w * x[0] * x[1]
            run[2] += w * x[0] * x[2]
            run[3] += w * x[1] * x[1]
            run[4] += w * x[1] * x[2]
            run[5] += w * x[2] * x[2]
            run[6] += w
        at = 0
        for a in range(3):
            for b in range(a, 3):
                sums[a, b] += run[at]
                at += 1
        total += run[6]
    for a in range(3):
        for b in range(a):
            sums[a, b] = sums[b, a]
    return sums / total


@njit(cache=True, nogil=True)
def third_moments(
    points: Any, weights: Any, centre: FloatArray, axes: FloatArray, spread: float
) -> FloatArray:
    """Return the weighted mean of the cubes of the coordinates along `axes`, over `spread`."""
    total, sums, run = 0.0, np.zeros(3), np.zeros(4)
    x = np.empty(3)
    for first in range(0, len(points), _RUN):
        run[:] = 0.0
        for j in range(first, min(len(points), first + _RUN)):
            w = weights[j] if len(weights) else 1.0
            for a in range(3):
                x[a] = np.float64(points[j, a]) - np.float64(points[0, a]) - centre[a]
            run[3] += w
            for a in range(3):
                along = (axes[a, 0] * x[0] + axes[a, 1] * x[1] + axes[a, 2] * x[2]) / spread
                run[a] += w * along * along * along
        sums += run[:3]
        total += run[3]
    return sums / total
