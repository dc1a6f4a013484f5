"""Nearest neighbours of points among themselves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mdcs_pipeline.kernels.compiled.grid import grid_of, scattered
from mdcs_pipeline.kernels.compiled.nearby import nearest_in_grid, usual_distance
from mdcs_pipeline.kernels.workers import shared_out, thread_count

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


# Points, and neighbours, from which and up to which a grid finds them sooner than a tree.
_FEW, _MANY = 500, 64
# Edge of a cell in the distance to the farthest that is sought, which so many points tell.
_CELL, _SAMPLES = 1.2, 12


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
    n, k = len(points), min(count, len(points) - 1)
    usual = usual_distance(points, k, _SAMPLES) if n >= _FEW and k < _MANY else 0.0
    if usual == 0.0:
        return Nearest(*_by_tree(points, np.arange(n), k))
    grid = grid_of(points, _CELL * usual)
    found = shared_out(lambda some: nearest_in_grid(grid, k, some), np.arange(n))
    distance, indices = (scattered(grid, held) for held in found)
    left = np.flatnonzero(np.isnan(distance[:, -1]))
    if len(left):
        distance[left], indices[left] = _by_tree(points, left, k)
    return Nearest(distance, indices)


def _by_tree(points: FloatArray, which: IntArray, count: int) -> tuple[FloatArray, IntArray]:
    """Return distances and names of the `count` nearest others of some points."""
    wanted = list(range(1, count + 2))
    found = cKDTree(points).query(points[which], k=wanted, workers=thread_count())
    distance = np.asarray(found[0], dtype=np.float64)
    index = np.asarray(found[1], dtype=np.int64)
    itself = index == which[:, None]
    # Among points that coincide it need not come first; among more than k, not at all.
    itself[~itself.any(axis=1), -1] = True
    shape = len(which), count
    return distance[~itself].reshape(shape), index[~itself].reshape(shape)
