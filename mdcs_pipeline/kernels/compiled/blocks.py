"""The truncated kernel as dense blocks, one for each box of points and its list of nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.exponential import vector_exp
from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray

# Rows are as long as whole vector registers: a loop's scalar rest costs more than zeros do.
_LANES = 16
# An exponent that stands for no node; its square must be a float32.
_NOWHERE = -1e9


@njit(cache=True, nogil=True)
def padded(count: int) -> int:
    """Return the length of a row for `count` nodes."""
    return (count + _LANES - 1) // _LANES * _LANES


@njit(cache=True, nogil=True)
def gather(
    nodes: IntArray, sites: FloatArray, centre: FloatArray, epsilon: float, level: float, local: Any
) -> None:
    """Write place, weight 1/(ε r) and (f − level)/ε of the listed nodes into `local`, (5, width).

    Places are taken from `centre` and potentials from `level`: what is left is small, and
    float32 holds it.
    """
    for k in range(len(nodes)):
        i = nodes[k]
        for a in range(3):
            local[a, k] = sites[a, i] - centre[a]
        local[3, k] = sites[6, i] / epsilon
        local[4, k] = (sites[7, i] - level) / epsilon
    for k in range(len(nodes), padded(len(nodes))):
        local[:, k] = 0.0
        local[4, k] = _NOWHERE


@njit(cache=True, nogil=True, fastmath=True)
def fill_row(
    y0: Any, y1: Any, y2: Any, weight: Any, local: Any, width: int, log_cut: Any, row: Any
) -> Any:
    """Write exp(e_i − max e) with e_i = (f_i − level − c_ij)/ε into `row` and return max e.

    What lies below the cut becomes 0. With its largest entry 1, no row can vanish.

    `level` is so high that no e_i is positive. `row` is a pair of arrays on the same memory,
    numbers and integers of their width, longer than `width`: numbers without a sign rise as
    their bits do, and it is of integers that compilers take a minimum in vectors.
    """
    values, bits = row[0][:width], row[1][:width]
    x0, x1, x2, near, f = local[0], local[1], local[2], local[3], local[4]
    zero = values.dtype.type(0.0)
    for k in range(len(values)):
        a, b, c = x0[k] - y0, x1[k] - y1, x2[k] - y2
        values[k] = max((a * a + b * b + c * c) * near[k] * weight - f[k], zero)
    least = bits[0]
    for k in range(len(bits)):
        least = min(least, bits[k])
    row[1][width] = least
    best = row[0][width]
    farthest = values.dtype.type(-log_cut)
    for k in range(len(values)):
        above = values[k] - best
        kept = vector_exp(-min(above, farthest), values)
        values[k] = kept if above <= farthest else zero
    return -best


@njit(cache=True, nogil=True)
def paired(length: int, like: Any) -> Any:
    """Return memory for `fill_row`: numbers and bits of the types of the arrays `like`."""
    values = np.empty(length + 1, like[0].dtype)
    return values, values.view(like[1].dtype)


@njit(cache=True, nogil=True)
def keep_row(row: Any, kept: Any, most: Any) -> None:
    """Copy a row and raise `most` to it, entry by entry."""
    for k in range(len(row)):
        kept[k] = row[k]
        most[k] = max(most[k], row[k])


@njit(cache=True, nogil=True)
def fill_blocks(
    points: FloatArray,
    weight: FloatArray,
    size: int,
    centres: FloatArray,
    sites: FloatArray,
    lists: tuple[IntArray, IntArray, FloatArray],
    epsilon: float,
    log_cut: float,
    like: Any,
    kernel: Any,
) -> tuple[IntArray, IntArray, IntArray, FloatArray, FloatArray]:
    """Write K_ij = exp((f_i − c_ij − top_j)/ε) into `kernel`, a row a point.

    Nodes that no point of a box needs are left out of its block.

    Parameters
    ----------
    lists : tuple
        From `box_lists`.
    like : pair of arrays
        float32 and int32, or float64 and int64.
    kernel : (K,) float
        With room for all that is listed.

    Returns
    -------
    starts : (B + 1,) int64
        Where each box's block begins in `kernel`.
    indptr, indices : (B + 1,), (K,)
        The nodes of each block, as many as its rows are long; what fills a row up is node 0.
    top : (n,) float64
        max_i(f_i − c_ij).
    slack : (m,) float64
        min_j(c_ij − f_i + top_j) over the points whose box lists node i, or infinity.
    """
    indptr, indices, levels = lists
    n, boxes, real = len(points), len(indptr) - 1, kernel.dtype.type
    starts = np.zeros(boxes + 1, np.int64)
    kept_ptr = np.zeros(boxes + 1, np.int64)
    kept = np.empty(len(indices) + _LANES * boxes, np.int32)
    top = np.empty(n)
    slack = np.full(sites.shape[1], np.inf)
    longest = 0
    for b in range(boxes):
        longest = max(longest, padded(indptr[b + 1] - indptr[b]))
    local = np.empty((5, longest), kernel.dtype)
    block = np.empty((size, longest), kernel.dtype)
    most, row = np.empty(longest, kernel.dtype), paired(longest, like)
    for b in range(boxes):
        nodes = indices[indptr[b] : indptr[b + 1]]
        width = padded(len(nodes))
        gather(nodes, sites, centres[b], epsilon, levels[b], local)
        first, last = b * size, min(n, (b + 1) * size)
        most[:width] = 0.0
        for j in range(first, last):
            y0 = real(points[j, 0] - centres[b, 0])
            y1 = real(points[j, 1] - centres[b, 1])
            y2 = real(points[j, 2] - centres[b, 2])
            high = fill_row(y0, y1, y2, real(weight[j]), local, width, log_cut, row)
            top[j] = levels[b] + epsilon * high
            keep_row(row[0][:width], block[j - first], most)
        count = _compress(nodes, block, most, last - first, starts, b, kernel, kept, kept_ptr)
        for k in range(len(nodes)):
            if most[k] > 0.0:
                slack[nodes[k]] = min(slack[nodes[k]], -epsilon * np.log(most[k]))
        kept_ptr[b + 1] = kept_ptr[b] + count
    return starts, kept_ptr, kept[: kept_ptr[boxes]].copy(), top, slack


@njit(cache=True, nogil=True)
def _compress(
    nodes: IntArray,
    block: Any,
    most: Any,
    rows: int,
    starts: IntArray,
    b: int,
    kernel: Any,
    kept: IntArray,
    kept_ptr: IntArray,
) -> int:
    """Copy the columns with any entry to `kernel`, name them in `kept`; return their number."""
    chosen = np.flatnonzero(most[: len(nodes)] > 0.0)
    width = padded(len(chosen))
    base = starts[b]
    for j in range(rows):
        at = base + j * width
        for k in range(len(chosen)):
            kernel[at + k] = block[j, chosen[k]]
        for k in range(len(chosen), width):
            kernel[at + k] = 0.0
    first = kept_ptr[b]
    for k in range(width):
        kept[first + k] = nodes[chosen[k]] if k < len(chosen) else 0
    starts[b + 1] = base + rows * width
    return width
