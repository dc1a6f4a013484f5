"""One pass over the truncated kernel, and the plan that it ends with."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray


@njit(cache=True, nogil=True)
def fill_kernel(
    indptr: IntArray,
    indices: IntArray,
    costs: FloatArray,
    potentials: FloatArray,
    epsilon: float,
) -> tuple[FloatArray, FloatArray]:
    """Return K = exp((f_i − c_ij − top_j)/ε) and top_j = max_i(f_i − c_ij).

    With its largest entry a row 1, no row can vanish (log-domain stabilisation).
    """
    n = len(indptr) - 1
    kernel = np.empty(len(indices))
    top = np.empty(n)
    for j in range(n):
        high = -np.inf
        for k in range(indptr[j], indptr[j + 1]):
            high = max(high, potentials[indices[k]] - costs[k])
        top[j] = high
        for k in range(indptr[j], indptr[j + 1]):
            kernel[k] = np.exp((potentials[indices[k]] - costs[k] - high) / epsilon)
    return kernel, top


@njit(cache=True, nogil=True, fastmath=True)
def sinkhorn_pass(
    indptr: IntArray,
    indices: IntArray,
    kernel: FloatArray,
    mass: FloatArray,
    scaling: FloatArray,
    received: FloatArray,
    sums: FloatArray,
) -> None:
    """Meet the point marginal for the node scaling u, and sum what each node then receives.

    s_j = Σ_i K_ij u_i, v_j = ϱ_j / s_j, received_i = Σ_j u_i K_ij v_j: both half-steps of
    Eq. 11's projections read the kernel once.
    """
    received[:] = 0.0
    for j in range(len(indptr) - 1):
        first, last = indptr[j], indptr[j + 1]
        total = 0.0
        for k in range(first, last):
            total += kernel[k] * scaling[indices[k]]
        sums[j] = total
        v = mass[j] / total
        for k in range(first, last):
            received[indices[k]] += kernel[k] * v
    for i in range(len(received)):
        received[i] *= scaling[i]


@njit(cache=True, nogil=True)
def fill_plan(
    indptr: IntArray,
    indices: IntArray,
    kernel: FloatArray,
    mass: FloatArray,
    scaling: FloatArray,
    sums: FloatArray,
) -> FloatArray:
    """Return π_ij = u_i K_ij ϱ_j / s_j in the order of the lists."""
    plan = np.empty(len(kernel))
    for j in range(len(indptr) - 1):
        v = mass[j] / sums[j]
        for k in range(indptr[j], indptr[j + 1]):
            plan[k] = kernel[k] * scaling[indices[k]] * v
    return plan
