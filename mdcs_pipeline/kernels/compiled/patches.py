"""Geodesic patches that grow until they close into a tube."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.heap import heap_drop, heap_push
from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray


@njit(cache=True, nogil=True)
def middle_variance(total: float, first: FloatArray, second: FloatArray) -> float:
    """Return the middle eigenvalue of a patch's covariance from its moments."""
    covariance = second / total - np.outer(first, first) / (total * total)
    middle: float = np.linalg.eigvalsh(covariance)[1]
    return max(middle, 0.0)


@njit(cache=True, nogil=True)
def closing_patches(
    indptr: IntArray,
    indices: IntArray,
    lengths: FloatArray,
    points: FloatArray,
    mass: FloatArray,
    sources: IntArray,
    radii: FloatArray,
    closed: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return √(2 λ2) of each source's geodesic ball where it has closed, its radius and centre.

    A ball of radius s has closed at the first of `radii` with λ2 ≤ closed · s². Where it never
    does, the whole part's λ2 is taken and the radius is infinite.
    """
    n = len(points)
    scale = np.empty(len(sources))
    reach = np.full(len(sources), np.inf)
    centre = np.empty((len(sources), 3))
    distance = np.full(n, np.inf)
    keys = np.empty(len(indices) + 1)
    values = np.empty(len(indices) + 1, np.int64)
    touched = np.empty(n, np.int64)
    for q in range(len(sources)):
        source = sources[q]
        distance[source] = 0.0
        touched[0] = source
        count = 1
        size = heap_push(keys, values, 0, 0.0, source)
        total = 0.0
        first = np.zeros(3)
        second = np.zeros((3, 3))
        at = 0
        while size > 0 and reach[q] == np.inf:
            near, v = keys[0], values[0]
            size = heap_drop(keys, values, size)
            if near > distance[v]:
                continue
            while at < len(radii) and near > radii[at]:
                variance = middle_variance(total, first, second)
                if variance <= closed * radii[at] ** 2:
                    scale[q] = np.sqrt(2.0 * variance)
                    reach[q] = radii[at]
                    break
                at += 1
            total += mass[v]
            for a in range(3):
                offset = points[v, a] - points[source, a]
                first[a] += mass[v] * offset
                for b in range(3):
                    second[a, b] += mass[v] * offset * (points[v, b] - points[source, b])
            for k in range(indptr[v], indptr[v + 1]):
                u = indices[k]
                far = near + lengths[k]
                if far < distance[u]:
                    if distance[u] == np.inf:
                        touched[count] = u
                        count += 1
                    distance[u] = far
                    size = heap_push(keys, values, size, far, u)
        if reach[q] == np.inf:
            scale[q] = np.sqrt(2.0 * middle_variance(total, first, second))
        for a in range(3):
            centre[q, a] = points[source, a] + first[a] / total
        for k in range(count):
            distance[touched[k]] = np.inf
    return scale, reach, centre


@njit(cache=True, nogil=True)
def spread_minimum(
    indptr: IntArray,
    indices: IntArray,
    lengths: FloatArray,
    values: FloatArray,
    slope: float,
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return min over points l of values_l + slope · geodesic distance, that distance, and l.

    l is -1 where no value reaches.
    """
    n = len(values)
    result = values.copy()
    carried = np.zeros(n)
    origin = np.full(n, -1)
    keys = np.empty(len(indices) + n + 1)
    heap = np.empty(len(indices) + n + 1, np.int64)
    size = 0
    for v in range(n):
        if values[v] < np.inf:
            origin[v] = v
            size = heap_push(keys, heap, size, values[v], v)
    while size > 0:
        near, v = keys[0], heap[0]
        size = heap_drop(keys, heap, size)
        if near > result[v]:
            continue
        for k in range(indptr[v], indptr[v + 1]):
            u = indices[k]
            far = near + slope * lengths[k]
            if far < result[u]:
                result[u] = far
                carried[u] = carried[v] + lengths[k]
                origin[u] = origin[v]
                size = heap_push(keys, heap, size, far, u)
    return result, carried, origin
