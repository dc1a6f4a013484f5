"""Eigenvalues and eigenvectors of symmetric 3 x 3 matrices, by Jacobi's rotations.

A library's call for one such matrix costs ten times what it computes. Rotations keep all digits
of a small eigenvalue beside a large one, which the cubic's formula does not.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.types import FloatArray

_SWEEPS = 12
# Of the squared diagonal: what is left beside it is round-off.
_DONE = 1e-34


@njit(cache=True, nogil=True, inline="always")
def _rotate(matrix: FloatArray, vectors: FloatArray, p: int, q: int) -> None:
    """Make the entry (p, q) 0, and turn the vectors with it."""
    off = matrix[p, q]
    if off == 0.0:
        return
    slope = 0.5 * (matrix[q, q] - matrix[p, p]) / off
    t = 1.0 / (abs(slope) + np.sqrt(slope * slope + 1.0))
    if slope < 0.0:
        t = -t
    cosine = 1.0 / np.sqrt(t * t + 1.0)
    sine = t * cosine
    r = 3 - p - q
    matrix[p, p] -= t * off
    matrix[q, q] += t * off
    matrix[p, q] = matrix[q, p] = 0.0
    one, other = matrix[r, p], matrix[r, q]
    matrix[r, p] = matrix[p, r] = cosine * one - sine * other
    matrix[r, q] = matrix[q, r] = sine * one + cosine * other
    for a in range(3):
        one, other = vectors[a, p], vectors[a, q]
        vectors[a, p] = cosine * one - sine * other
        vectors[a, q] = sine * one + cosine * other


@njit(cache=True, nogil=True)
def principal(matrix: FloatArray, values: FloatArray, vectors: FloatArray) -> None:
    """Write the eigenvalues, rising, into `values` and unit vectors into the columns of `vectors`.

    `matrix`, (3, 3) and symmetric, is used up. Of vectors the signs mean nothing.
    """
    vectors[:] = 0.0
    for a in range(3):
        vectors[a, a] = 1.0
    for _ in range(_SWEEPS):
        beside = matrix[0, 1] ** 2 + matrix[0, 2] ** 2 + matrix[1, 2] ** 2
        if beside <= _DONE * (matrix[0, 0] ** 2 + matrix[1, 1] ** 2 + matrix[2, 2] ** 2):
            break
        _rotate(matrix, vectors, 0, 1)
        _rotate(matrix, vectors, 0, 2)
        _rotate(matrix, vectors, 1, 2)
    for a in range(3):
        values[a] = matrix[a, a]
    for first, second in ((0, 1), (1, 2), (0, 1)):
        if values[first] > values[second]:
            values[first], values[second] = values[second], values[first]
            for a in range(3):
                held = vectors[a, first]
                vectors[a, first] = vectors[a, second]
                vectors[a, second] = held


@njit(cache=True, nogil=True)
def middle_eigenvalue(moments: FloatArray) -> float:
    """Return the middle eigenvalue of a patch's covariance from its moments, by rotations.

    `moments` are Σ m, Σ m x, y, z, and Σ m xx, xy, xz, yy, yz, zz. Jacobi's rotations keep
    all digits of a small eigenvalue beside a large one, which the cubic's formula does not.
    """
    total = moments[0]
    x, y, z = moments[1] / total, moments[2] / total, moments[3] / total
    a, b, c = moments[4] / total - x * x, moments[7] / total - y * y, moments[9] / total - z * z
    d, e, f = moments[5] / total - x * y, moments[6] / total - x * z, moments[8] / total - y * z
    for _ in range(12):
        if d * d + e * e + f * f <= 1e-32 * (a * a + b * b + c * c):
            break
        a, b, d, e, f = _rotated(a, b, d, e, f)
        a, c, e, d, f = _rotated(a, c, e, d, f)
        b, c, f, d, e = _rotated(b, c, f, d, e)
    middle: float = max(max(min(a, b), min(max(a, b), c)), 0.0)
    return middle


@njit(cache=True, nogil=True, inline="always")
def _rotated(
    p: float, q: float, off: float, one: float, other: float
) -> tuple[float, float, float, float, float]:
    """Return a symmetric matrix after the rotation that makes the entry `off` of p and q 0."""
    if off == 0.0:
        return p, q, off, one, other
    slope = 0.5 * (q - p) / off
    t = 1.0 / (abs(slope) + np.sqrt(slope * slope + 1.0))
    if slope < 0.0:
        t = -t
    cosine = 1.0 / np.sqrt(t * t + 1.0)
    sine = t * cosine
    return (
        p - t * off,
        q + t * off,
        0.0,
        cosine * one - sine * other,
        sine * one + cosine * other,
    )
