"""Voxel means: a point for every cube that holds any."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.canonical import CanonicalFrame
from mdcs_pipeline.kernels.compiled.cells import cell_sums

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


def voxel_means(
    points: NDArray[np.floating[Any]],
    weights: FloatArray | None,
    size: float,
    frame: CanonicalFrame | None = None,
) -> Voxels:
    """Return the weighted centroid and total weight of every occupied voxel.

    Points are taken one by one: the memory is that of the voxels, however many points.

    Parameters
    ----------
    points : (N, 3) float32 or float64
    weights : (N,) float64 or None
        All 1 when absent.
    size : float
        Edge of a voxel; the cloud may span at most `MAX_CELLS` of them around the origin.
    frame : CanonicalFrame, optional
        Whose coordinates voxels and centroids are in; those of the points when absent.

    Returns
    -------
    Voxels

    Raises
    ------
    ValueError
        If the cloud spans more voxels than can be counted.
    """
    if frame is None:
        frame = CanonicalFrame(np.zeros(3), np.eye(3), 1.0)
    # The origin is a cell's centre: flat and straight clouds, which lie on planes through it,
    # are not split by round-off.
    share = np.empty(0) if weights is None else weights
    codes, sums = cell_sums(points, share, *frame, size, MAX_CELLS, _BITS)
    if len(points) and not len(codes):
        raise ValueError(f"the cloud spans more than {MAX_CELLS} voxels of edge {size:.3g}")
    sums = sums[np.argsort(codes)]
    return Voxels(sums[:, :3] / sums[:, 3:], np.ascontiguousarray(sums[:, 3]))
