"""Links between points as rows of a sparse matrix, made and thinned out in one go."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mdcs_pipeline.kernels.compiled.types import BoolArray, FloatArray, IntArray

Index = NDArray[np.int32]


@njit(cache=True, nogil=True)
def along_surface(
    points: FloatArray,
    indices: IntArray,
    length: FloatArray,
    normals: FloatArray,
    most: int,
    steepest: float,
) -> BoolArray:
    """Return which links lie along the surface, the first `most` of each point.

    Parameters
    ----------
    points : (n, 3) float64
    indices : (n, k) int64
        Neighbours by rising distance.
    length : (n, k) float64
        Distances, positive.
    normals : (n, 3) float64
    most : int
    steepest : float
        Largest of the smaller |cosine| of a link with the normals at its ends.

    Returns
    -------
    (n, k) bool
    """
    n, wide = indices.shape
    kept = np.zeros((n, wide), np.bool_)
    for i in range(n):
        count = 0
        for k in range(wide):
            j, here, there = indices[i, k], 0.0, 0.0
            for a in range(3):
                step = (points[j, a] - points[i, a]) / length[i, k]
                here += step * normals[i, a]
                there += step * normals[j, a]
            if min(abs(here), abs(there)) <= steepest:
                kept[i, k] = True
                count += 1
                if count == most:
                    break
    return kept


@njit(cache=True, nogil=True)
def _named_by(
    indices: IntArray, length: FloatArray, kept: BoolArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return rows of the points that name each point, and how far away they are."""
    n, wide = indices.shape
    ends = np.zeros(n + 1, np.int64)
    for i in range(n):
        for k in range(wide):
            ends[indices[i, k] + 1] += kept[i, k]
    ends = np.cumsum(ends)
    names, far, at = np.empty(ends[n], np.int64), np.empty(ends[n]), ends[:n].copy()
    for i in range(n):
        for k in range(wide):
            if kept[i, k]:
                j = indices[i, k]
                names[at[j]], far[at[j]] = i, length[i, k]
                at[j] += 1
    return ends, names, far


@njit(cache=True, nogil=True)
def both_ways(
    indices: IntArray, length: FloatArray, kept: BoolArray
) -> tuple[Index, Index, FloatArray]:
    """Return links of points as a symmetric CSR matrix with sorted rows.

    Parameters
    ----------
    indices : (n, k) int64
    length : (n, k) float64
    kept : (n, k) bool
        Links that count; where both ends name each other the larger length does.

    Returns
    -------
    indptr : (n + 1,) int32
    indices : (e,) int32
    data : (e,) float64
    """
    n, wide = indices.shape
    ends, names, far = _named_by(indices, length, kept)
    first, second = np.empty(2 * ends[n], np.int64), np.empty(2 * ends[n])
    rows, seen, count = np.zeros(n + 1, np.int64), np.full(n, -1), 0
    for i in range(n):
        for e in range(ends[i], ends[i + 1]):
            first[count], second[count] = names[e], far[e]
            seen[names[e]] = count
            count += 1
        for k in range(wide):
            if kept[i, k]:
                known = seen[indices[i, k]]
                if known >= rows[i]:
                    second[known] = max(second[known], length[i, k])
                else:
                    first[count], second[count] = indices[i, k], length[i, k]
                    count += 1
        rows[i + 1] = count
    # The matrix is its own mirror image, whose rows come out sorted.
    result, data, at = np.empty(count, np.int32), np.empty(count), rows[:n].copy()
    for i in range(n):
        for e in range(rows[i], rows[i + 1]):
            j = first[e]
            result[at[j]], data[at[j]] = i, second[e]
            at[j] += 1
    return rows.astype(np.int32), result, data


@njit(cache=True, nogil=True)
def between_groups(
    indptr: IntArray, indices: IntArray, into: IntArray, count: int
) -> tuple[IntArray, IntArray]:
    """Return which groups of points are linked, as CSR rows without values, each pair once.

    Parameters
    ----------
    indptr, indices
        Links of n points.
    into : (n,) int64
        Group of each point; a group whose points are linked is linked to itself.
    count : int
        Groups.
    """
    starts = np.zeros(count + 1, np.int64)
    for group in into:
        starts[group + 1] += 1
    starts = np.cumsum(starts)
    members, at = np.empty(len(into), np.int64), starts[:count].copy()
    for v in range(len(into)):
        members[at[into[v]]] = v
        at[into[v]] += 1
    rows, found = np.zeros(count + 1, np.int64), np.empty(len(indices), np.int64)
    seen, size = np.full(count, -1), 0
    for group in range(count):
        for v in members[starts[group] : starts[group + 1]]:
            for e in range(indptr[v], indptr[v + 1]):
                other = into[indices[e]]
                if seen[other] != group:
                    seen[other] = group
                    found[size] = other
                    size += 1
        rows[group + 1] = size
    return rows, found[:size].copy()


@njit(cache=True, nogil=True)
def within_limbs(
    indptr: IntArray,
    indices: IntArray,
    points: FloatArray,
    places: FloatArray,
    radius: FloatArray,
    trust: FloatArray,
    gap: FloatArray,
) -> tuple[BoolArray, Index]:
    """Return which links do not lead across a gap, and where each point's begin then (CSR).

    One does whose medial places, both believed, are farther apart than its points by more than
    the larger `gap` of both, in the smaller radius.
    """
    kept, rows = np.ones(len(indices), np.bool_), np.zeros(len(points) + 1, np.int32)
    for i in range(len(points)):
        count = rows[i]
        for e in range(indptr[i], indptr[i + 1]):
            j, inside, outside = indices[e], 0.0, 0.0
            if min(trust[i], trust[j]) > 0.5:
                for a in range(3):
                    inside += (places[i, a] - places[j, a]) ** 2
                    outside += (points[i, a] - points[j, a]) ** 2
                apart = np.sqrt(inside) - np.sqrt(outside)
                kept[e] = apart <= max(gap[i], gap[j]) * min(radius[i], radius[j])
            count += kept[e]
        rows[i + 1] = count
    return kept, rows
