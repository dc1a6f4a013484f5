"""Accelerated Sinkhorn passes over the blocks, to the end without leaving compiled code."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.mixing import mixed_step
from mdcs_pipeline.kernels.compiled.types import BoolArray, FloatArray, IntArray


@njit(cache=True, nogil=True, fastmath=True)
def _dot(row: Any, other: Any) -> Any:
    total = row.dtype.type(0.0)
    for k in range(len(row)):
        total += row[k] * other[k]
    return total


@njit(cache=True, nogil=True, fastmath=True)
def _add(row: Any, factor: Any, to: Any) -> None:
    for k in range(len(row)):
        to[k] += factor * row[k]


@njit(cache=True, nogil=True)
def sinkhorn_pass(
    kernel: Any,
    starts: IntArray,
    indptr: IntArray,
    indices: IntArray,
    size: int,
    mass: FloatArray,
    scaling: FloatArray,
    received: FloatArray,
    sums: FloatArray,
) -> None:
    """Meet the point marginal for the node scaling u, and sum what each node then receives.

    s_j = Σ_i K_ij u_i, v_j = ϱ_j / s_j, received_i = Σ_j u_i K_ij v_j: both half-steps of
    Eq. 11's projections read the kernel once.
    """
    n = len(mass)
    real = kernel.dtype.type
    longest = 0
    for b in range(len(starts) - 1):
        longest = max(longest, indptr[b + 1] - indptr[b])
    u = np.empty(longest, kernel.dtype)
    gained = np.empty(longest, kernel.dtype)
    received[:] = 0.0
    for b in range(len(starts) - 1):
        own = indices[indptr[b] : indptr[b + 1]]
        width, base = len(own), starts[b]
        for k in range(width):
            u[k] = scaling[own[k]]
            gained[k] = 0.0
        for j in range(b * size, min(n, (b + 1) * size)):
            row = kernel[base : base + width]
            sums[j] = _dot(row, u)
            _add(row, real(mass[j] / sums[j]), gained)
            base += width
        for k in range(width):
            received[own[k]] += gained[k]
    for i in range(len(received)):
        received[i] *= scaling[i]


@njit(cache=True, nogil=True)
def drift(log_scaling: FloatArray, lifted: BoolArray) -> float:
    """Return by how many ε a potential has risen against another since the blocks were made.

    The way back down of a lifted node does not count. It is no point's best, so that the
    other columns do not depend on it; and a node of little mass, lifted every time, would
    have the blocks made again for ever.
    """
    high, low = -np.inf, np.inf
    for i in range(len(log_scaling)):
        high = max(high, log_scaling[i])
        if not lifted[i]:
            low = min(low, log_scaling[i])
    return high - low


@njit(cache=True, nogil=True)
def iterate(
    kernel: Any,
    starts: IntArray,
    indptr: IntArray,
    indices: IntArray,
    size: int,
    mass: FloatArray,
    target: FloatArray,
    lifted: BoolArray,
    tolerance: float,
    budget: int,
    refill: float,
    clip: float,
    memory: tuple[FloatArray, FloatArray, FloatArray],
    held: int,
) -> tuple[FloatArray, FloatArray, int, float, int]:
    """Run accelerated passes until the marginal is met, a drift of `refill`, or `budget`.

    Where the error rises to twice the best, it goes back to a plain step from the best
    point and forgets what it extrapolated from.

    Parameters
    ----------
    memory, held
        What `mixed_step` remembers, and how many steps; written to.

    Returns
    -------
    log_scaling : (m,) float64
    sums : (n,) float64
        s_j for that scaling.
    passes : int
    error : float
        L1 distance of what nodes receive from `target`.
    held : int
    """
    m = len(target)
    z, best = np.zeros(m), np.zeros(m)
    received, sums, residual = np.empty(m), np.empty(len(mass)), np.empty(m)
    root, logs = np.sqrt(target), np.log(target)
    moves, turns, normal = memory
    least, passes = np.inf, 0
    while True:
        # Padding names node 0 with entries 0. The largest scaling is 1: float32 could overflow.
        shift = z.max()
        args = kernel, starts, indptr, indices, size, mass
        sinkhorn_pass(*args, np.exp(z - shift), received, sums)
        passes += 1
        error = np.abs(received - target).sum()
        far = drift(z, lifted) > refill
        if error <= tolerance or passes >= budget:
            sums *= np.exp(shift)
            return z, sums, passes, error, held
        for i in range(m):
            residual[i] = logs[i] - np.log(max(received[i], 1e-300))
        if error > 2.0 * least:
            held = 0
            z[:] = best
            least = np.inf
            continue
        if error < least:
            best[:] = z + residual
            least = error
        held = mixed_step(z, residual, root, clip, moves, turns, normal, held)
        if far:
            # The step is taken first: the new kernel's first pass would only repeat this one.
            return z, sums, passes, error, held
