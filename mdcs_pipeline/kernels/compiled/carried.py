"""What a plan carries to each node, summed while its rows are at hand: no plan is stored."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.blocks import fill_row, gather, padded, paired
from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray


@njit(cache=True, nogil=True, fastmath=True)
def add_row(row: Any, v: Any, y0: Any, y1: Any, y2: Any, weight: Any, carried: Any) -> None:
    """Add one point's share π_i = v row_i of each node: π, π w, π w y, π/w with w = 1/r_j."""
    heavy, light = v * weight, v / weight
    c0, c1, c2, c3, c4, c5 = (
        carried[0],
        carried[1],
        carried[2],
        carried[3],
        carried[4],
        carried[5],
    )
    for k in range(len(row)):
        entry = row[k]
        share = heavy * entry
        c0[k] += v * entry
        c1[k] += share
        c2[k] += share * y0
        c3[k] += share * y1
        c4[k] += share * y2
        c5[k] += light * entry


@njit(cache=True, nogil=True)
def scatter(nodes: IntArray, carried: Any, centre: FloatArray, total: FloatArray) -> None:
    """Add a box's sums, taken from its centre, to those of all nodes, (6, m)."""
    for k in range(len(nodes)):
        i = nodes[k]
        total[0, i] += carried[0, k]
        total[1, i] += carried[1, k]
        for a in range(3):
            total[2 + a, i] += carried[2 + a, k] + centre[a] * carried[1, k]
        total[5, i] += carried[5, k]


@njit(cache=True, nogil=True, fastmath=True)
def total_of(row: Any) -> Any:
    """Return the sum of a row."""
    total = row.dtype.type(0.0)
    for k in range(len(row)):
        total += row[k]
    return total


@njit(cache=True, nogil=True)
def free_boxes(
    points: FloatArray,
    weight: FloatArray,
    mass: FloatArray,
    size: int,
    centres: FloatArray,
    sites: FloatArray,
    lists: tuple[IntArray, IntArray, FloatArray],
    epsilon: float,
    log_cut: float,
    span: tuple[int, int],
    like: Any,
) -> tuple[FloatArray, FloatArray]:
    """Return what nodes receive at their potentials, without a kernel that is kept.

    Parameters
    ----------
    lists : tuple
        From `box_lists`.
    span : tuple of int
        The boxes that are done.
    like : pair of arrays
        float32 and int32, or float64 and int64: what is computed in.

    Returns
    -------
    total : (6, m) float64
        Σ π_ij, Σ π_ij/r_j, Σ π_ij y_j/r_j and Σ π_ij r_j over the points of these boxes.
    potentials : (n',) float64
        g_j of these points.
    """
    indptr, indices, levels = lists
    n, kind = len(points), like[0].dtype
    real = kind.type
    start, stop = span[0] * size, min(n, span[1] * size)
    total = np.zeros((6, sites.shape[1]))
    potentials = np.empty(stop - start)
    longest = 0
    for b in range(span[0], span[1]):
        longest = max(longest, padded(indptr[b + 1] - indptr[b]))
    local, carried = np.empty((5, longest), kind), np.empty((6, longest), kind)
    row = paired(longest, like)
    for b in range(span[0], span[1]):
        nodes, centre = indices[indptr[b] : indptr[b + 1]], centres[b]
        width = padded(len(nodes))
        gather(nodes, sites, centre, epsilon, levels[b], local)
        carried[:, :width] = 0.0
        for j in range(b * size, min(n, (b + 1) * size)):
            y0 = real(points[j, 0] - centre[0])
            y1 = real(points[j, 1] - centre[1])
            y2 = real(points[j, 2] - centre[2])
            w = real(weight[j])
            high = fill_row(y0, y1, y2, w, local, width, log_cut, row)
            s = total_of(row[0][:width])
            add_row(row[0][:width], real(mass[j] / s), y0, y1, y2, w, carried)
            potentials[j - start] = epsilon * (np.log(mass[j] / s) - high) - levels[b]
        scatter(nodes, carried, centre, total)
    return total, potentials


@njit(cache=True, nogil=True)
def carried_by_blocks(
    points: FloatArray,
    weight: FloatArray,
    mass: FloatArray,
    size: int,
    centres: FloatArray,
    kernel: Any,
    starts: IntArray,
    indptr: IntArray,
    indices: IntArray,
    scaling: FloatArray,
    sums: FloatArray,
) -> FloatArray:
    """Return the sums of `free_boxes`, (6, m), for the plan u_i K_ij ϱ_j / s_j."""
    n, real = len(points), kernel.dtype.type
    total = np.zeros((6, len(scaling)))
    longest = 0
    for b in range(len(starts) - 1):
        longest = max(longest, indptr[b + 1] - indptr[b])
    carried = np.empty((6, longest), kernel.dtype)
    for b in range(len(starts) - 1):
        nodes, centre = indices[indptr[b] : indptr[b + 1]], centres[b]
        width, base = len(nodes), starts[b]
        carried[:, :width] = 0.0
        for j in range(b * size, min(n, (b + 1) * size)):
            y0 = real(points[j, 0] - centre[0])
            y1 = real(points[j, 1] - centre[1])
            y2 = real(points[j, 2] - centre[2])
            v = real(mass[j] / sums[j])
            add_row(kernel[base : base + width], v, y0, y1, y2, real(weight[j]), carried)
            base += width
        scatter(nodes, carried, centre, total)
    for i in range(len(scaling)):
        total[:, i] *= scaling[i]
    return total
