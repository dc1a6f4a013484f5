"""Nearest neighbours of points among themselves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mdcs_pipeline.kernels.workers import thread_count

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Nearest(NamedTuple):
    """Each point's neighbours by rising distance, without itself.

    Parameters
    ----------
    distance : (n, k) float64
    indices : (n, k) int64
    """

    distance: FloatArray
    indices: IntArray


def nearest(points: FloatArray, count: int) -> Nearest:
    """Return the `count` nearest others of every point; fewer where there are not as many.

    Parameters
    ----------
    points : (n, 3) float64
    count : int

    Returns
    -------
    Nearest
    """
    k = min(count + 1, len(points))
    found = cKDTree(points).query(points, k=list(range(1, k + 1)), workers=thread_count())
    distance = np.asarray(found[0], dtype=np.float64)
    index = np.asarray(found[1], dtype=np.int64)
    itself = index == np.arange(len(points))[:, None]
    # Among points that coincide it need not come first; among more than k, not at all.
    itself[~itself.any(axis=1), -1] = True
    shape = len(points), k - 1
    return Nearest(distance[~itself].reshape(shape), index[~itself].reshape(shape))
