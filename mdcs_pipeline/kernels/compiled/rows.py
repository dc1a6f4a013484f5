"""The plan, row by row in the order of the points."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray


@njit(cache=True, nogil=True)
def plan_rows(
    kernel: Any,
    starts: IntArray,
    indptr: IntArray,
    indices: IntArray,
    size: int,
    order: IntArray,
    names: IntArray,
    mass: FloatArray,
    scaling: FloatArray,
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return π_ij = u_i K_ij ϱ_j / s_j as CSR (indptr, indices, data), rows in points' order.

    `order` names the point of each row of the blocks and `names` the node of each of their
    indices; `scaling` follows the blocks' own, `mass` the rows. Rows are summed again in
    float64: whatever the kernel is kept in, a point gives all of its mass.
    """
    n = len(order)
    lengths = np.zeros(n + 1, np.int64)
    for b in range(len(starts) - 1):
        width, base = indptr[b + 1] - indptr[b], starts[b]
        for j in range(b * size, min(n, (b + 1) * size)):
            for k in range(width):
                lengths[order[j] + 1] += kernel[base + k] > 0.0
            base += width
    rows = np.cumsum(lengths)
    columns = np.empty(rows[n], np.int32)
    data = np.empty(rows[n])
    for b in range(len(starts) - 1):
        width, base, place = indptr[b + 1] - indptr[b], starts[b], indptr[b]
        own = names[indices[place : place + width]]
        rising = np.argsort(own)
        for j in range(b * size, min(n, (b + 1) * size)):
            at = rows[order[j]]
            total = 0.0
            for k in range(width):
                total += kernel[base + k] * scaling[indices[place + k]]
            v = mass[j] / total
            for k in rising:
                entry = kernel[base + k]
                if entry > 0.0:
                    columns[at] = own[k]
                    data[at] = scaling[indices[place + k]] * entry * v
                    at += 1
            base += width
    return rows, columns, data
