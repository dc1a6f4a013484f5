"""Rims: where the sampled surface ends, at a hole or at the edge of what was seen.

Seen along the normal, the neighbours of a point inside a surface stand all around it; those of
a point on a rim leave a wide angle free.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.surface import principal_axes

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def free_angle(points: FloatArray, indices: IntArray) -> FloatArray:
    """Return the widest angle, seen along its normal, that each point's neighbours leave free.

    Parameters
    ----------
    points : (n, 3) float64
    indices : (n, k) int64
        Neighbours of each point.

    Returns
    -------
    (n,) float64
        Radians, in (0, 2π].
    """
    axes = principal_axes(points, indices)
    around = points[indices] - points[:, None]
    across = np.einsum("nka,na->nk", around, axes[:, :, 1])
    along = np.einsum("nka,na->nk", around, axes[:, :, 2])
    angle = np.sort(np.arctan2(across, along), axis=1)
    closing = angle[:, :1] + 2.0 * np.pi - angle[:, -1:]
    gaps = np.concatenate([np.diff(angle, axis=1), closing], axis=1)
    return np.asarray(gaps.max(axis=1), dtype=np.float64)
