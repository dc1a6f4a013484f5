"""What nodes share through the points that both of them serve."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray


@njit(cache=True, nogil=True)
def common_mass(
    indptr: IntArray, indices: IntArray, data: FloatArray, weight: FloatArray, count: int
) -> FloatArray:
    """Return Σ_j w_j π_ij π_kj for each two nodes i < k, (m, m); 0 elsewhere.

    Parameters
    ----------
    indptr, indices, data
        π_ij by point j (rows) and node i (columns), CSR.
    weight : (n,) float64
        w_j.
    count : int
        m.

    Returns
    -------
    (m, m) float64
    """
    total = np.zeros((count, count))
    for j in range(len(indptr) - 1):
        for a in range(indptr[j], indptr[j + 1]):
            i, share = indices[a], data[a]
            for b in range(indptr[j], indptr[j + 1]):
                k = indices[b]
                if i < k:
                    total[i, k] += share * (weight[j] * data[b])
    return total
