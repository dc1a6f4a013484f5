"""Voxel means: a point for every cube that holds any."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Voxels(NamedTuple):
    """Occupied voxels, in the order of their grid coordinates.

    Parameters
    ----------
    centroids : (V, 3) float64
        Weighted mean of each voxel's points.
    weights : (V,) float64
        Sum of their weights.
    """

    centroids: FloatArray
    weights: FloatArray


# Grid coordinates are packed into one int64, 21 bits an axis.
_BITS = 21
MAX_CELLS = 2 ** (_BITS - 1) - 1


def voxel_means(points: FloatArray, weights: FloatArray | None, size: float) -> Voxels:
    """Return the weighted centroid and total weight of every occupied voxel.

    Parameters
    ----------
    points : (N, 3) float64
    weights : (N,) float64 or None
        All 1 when absent.
    size : float
        Edge of a voxel; the cloud may span at most `MAX_CELLS` of them around the origin.

    Returns
    -------
    Voxels

    Raises
    ------
    ValueError
        If the cloud spans more voxels than can be counted.
    """
    # The origin is a cell's centre: flat and straight clouds, which lie on planes through it,
    # are not split by round-off.
    cells = np.floor(points / size + 0.5)
    if len(cells) and np.abs(cells).max() > MAX_CELLS:
        raise ValueError(f"the cloud spans more than {MAX_CELLS} voxels of edge {size:.3g}")
    coded = (cells.astype(np.int64) + MAX_CELLS + 1) @ np.array(
        [1 << (2 * _BITS), 1 << _BITS, 1], dtype=np.int64
    )
    _, group = np.unique(coded, return_inverse=True)
    total = np.bincount(group, weights)
    share = np.ones(len(points)) if weights is None else weights
    sums = np.stack([np.bincount(group, share * points[:, axis]) for axis in range(3)], axis=1)
    return Voxels(sums / total[:, None], total.astype(np.float64))
