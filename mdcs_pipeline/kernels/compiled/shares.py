"""To which nodes a point gives most of its mass."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray


@njit(cache=True, nogil=True)
def top_shares(
    indptr: IntArray, indices: IntArray, plan: FloatArray, count: int
) -> tuple[IntArray, FloatArray]:
    """Return the (n, count) largest shares π_ij/ϱ_j of each point and their nodes.

    Where a point serves fewer nodes, the node is −1 and the share 0.
    """
    n = len(indptr) - 1
    nodes = np.full((n, count), -1, np.int64)
    shares = np.zeros((n, count))
    for j in range(n):
        total = 0.0
        for k in range(indptr[j], indptr[j + 1]):
            value = plan[k]
            total += value
            if value <= shares[j, count - 1]:
                continue
            at = count - 1
            while at > 0 and shares[j, at - 1] < value:
                shares[j, at] = shares[j, at - 1]
                nodes[j, at] = nodes[j, at - 1]
                at -= 1
            shares[j, at] = value
            nodes[j, at] = indices[k]
        if total > 0.0:
            for c in range(count):
                shares[j, c] /= total
    return nodes, shares
