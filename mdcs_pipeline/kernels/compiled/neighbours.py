"""The axes of what lies around a point."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.symmetric import principal
from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray


@njit(cache=True, nogil=True)
def neighbour_axes(points: FloatArray, indices: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return variances, rising, and axes in columns, of each point and its neighbours together.

    Parameters
    ----------
    points : (n, 3) float64
    indices : (n, k) int64

    Returns
    -------
    values : (n, 3) float64
        Times k + 1.
    axes : (n, 3, 3) float64
        Unit; signs mean nothing.
    """
    n, count = indices.shape
    values, axes = np.empty((n, 3)), np.empty((n, 3, 3))
    matrix, patch = np.empty((3, 3)), np.empty((count + 1, 3))
    for i in range(n):
        mean = np.zeros(3)
        for k in range(count + 1):
            at = i if k == 0 else indices[i, k - 1]
            for a in range(3):
                # From the point itself: coordinates far from 0 would cost digits.
                patch[k, a] = points[at, a] - points[i, a]
                mean[a] += patch[k, a]
        matrix[:] = 0.0
        for k in range(count + 1):
            for a in range(3):
                patch[k, a] -= mean[a] / (count + 1)
            for a in range(3):
                for b in range(a + 1):
                    matrix[a, b] += patch[k, a] * patch[k, b]
        for a in range(3):
            for b in range(a):
                matrix[b, a] = matrix[a, b]
        principal(matrix, values[i], axes[i])
    return values, axes
