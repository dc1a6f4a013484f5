"""Points that belong to no surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.nearest import Nearest

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


def roundness(points: FloatArray, indices: NDArray[np.int64]) -> FloatArray:
    """Return λ1/λ3 of each point's neighbours, smallest over largest variance.

    It is near 0 where they lie on a surface or along a line, and about a quarter where they
    fill space.

    Parameters
    ----------
    points : (n, 3) float64
    indices : (n, k) int64
        Neighbours of each point.

    Returns
    -------
    (n,) float64
    """
    offset = points[indices] - points[indices].mean(axis=1, keepdims=True)
    values = np.linalg.eigvalsh(np.einsum("nka,nkb->nab", offset, offset))
    return np.asarray(values[:, 0] / np.maximum(values[:, 2], np.finfo(float).tiny))


def lonely_points(
    points: FloatArray, found: Nearest, near: float, sparse: float, far: float, round_from: float
) -> BoolArray:
    """Return the points that are too far from others to lie on the same surface.

    The radius of a point is the distance to its k-th neighbour. One beside a surface has a
    larger radius than its neighbours. Those among their like do not; but on a surface sampled
    seven times denser at one place than at another the radius varies by 2.6 as well, so that
    a large one alone does not tell: the neighbours must also fill space instead of a surface.

    Parameters
    ----------
    points : (n, 3) float64
    found : Nearest
        k neighbours of each point.
    near : float
        Radius, in medians of its neighbours' radii, from which a point is lonely.
    sparse : float
        Radius, in medians, from which points whose neighbours fill space are lonely.
    far : float
        Radius, in medians, from which all points are.
    round_from : float
        λ1/λ3 from which neighbours fill space.

    Returns
    -------
    (n,) bool
    """
    radius = found.distance[:, -1]
    relative = radius / max(float(np.median(radius)), np.finfo(float).tiny)
    suspect = np.flatnonzero(relative > sparse)
    beside = radius > near * np.median(radius[found.indices], axis=1)
    lonely = (relative > far) | beside
    lonely[suspect] |= roundness(points, found.indices[suspect]) > round_from
    return np.asarray(lonely, dtype=np.bool_)
