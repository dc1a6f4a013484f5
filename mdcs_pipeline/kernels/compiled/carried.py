"""What a plan carries to each node, summed while its rows are at hand: no plan is stored."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.exponential import vector_exp
from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray

# Above all exponents; loops that reckon without infinities meet it.
_FAR = 1e30


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


@njit(cache=True, nogil=True)
def _load(
    points: FloatArray,
    weight: FloatArray,
    mass: FloatArray,
    rows: tuple[int, int],
    centre: FloatArray,
    cloud: Any,
    own: Any,
) -> None:
    """Write places from its centre, 1/r_j and masses of a box's points, so many from a first."""
    for j in range(len(own)):
        # What fills up the last box is its last point again, without mass.
        at = rows[0] + min(j, rows[1] - 1)
        for a in range(3):
            cloud[a, j] = points[at, a] - centre[a]
        cloud[3, j], own[j] = weight[at], mass[at] if j < rows[1] else 0.0


@njit(cache=True, nogil=True, fastmath=True)
def _exponents(
    x: tuple[float, float, float], near: float, f: float, cloud: Any, row: Any, least: Any
) -> None:
    """Write (c_ij − f_i)/ε of a node and a box's points, and lower `least` to it."""
    y0, y1, y2, weight = cloud[0], cloud[1], cloud[2], cloud[3]
    x0, x1, x2 = x
    zero = least.dtype.type(0.0)
    for j in range(len(row)):
        a, b, c = x0 - y0[j], x1 - y1[j], x2 - y2[j]
        value = max((a * a + b * b + c * c) * near * weight[j] - f, zero)
        row[j] = value
        least[j] = min(least[j], value)


@njit(cache=True, nogil=True, fastmath=True)
def _entries(row: Any, least: Any, farthest: Any, sums: Any) -> bool:
    """Turn a node's exponents into kernel entries, 1 for each point's best, and sum them up.

    Returns
    -------
    bool
        Whether there is any: lists hold nodes that no point of their box needs.
    """
    zero, served = least.dtype.type(0.0), 0
    for j in range(len(row)):
        served += row[j] - least[j] <= farthest
    if served == 0:
        return False
    for j in range(len(row)):
        above = row[j] - least[j]
        kept = vector_exp(-min(above, farthest), least)
        entry = kept if above <= farthest else zero
        row[j] = entry
        sums[j] += entry
    return True


@njit(cache=True, nogil=True, fastmath=True)
def _shares(cloud: Any, mass: Any, sums: Any, shares: Any) -> None:
    """Write what an entry of 1 carries: π, π w, π w y, π/w with w = 1/r_j, a row each."""
    for j in range(len(mass)):
        v = mass[j] / sums[j]
        heavy = v * cloud[3, j]
        shares[0, j], shares[1, j], shares[5, j] = v, heavy, v / cloud[3, j]
        for a in range(3):
            shares[2 + a, j] = heavy * cloud[a, j]


@njit(cache=True, nogil=True, fastmath=True)
def _carry(row: Any, shares: Any, centre: FloatArray, total: FloatArray, i: int) -> None:
    """Add what a box's points, with places from its centre, carry to node i."""
    s0, s1, s2, s3, s4, s5 = shares[0], shares[1], shares[2], shares[3], shares[4], shares[5]
    zero = shares.dtype.type(0.0)
    c0, c1, c2, c3, c4, c5 = zero, zero, zero, zero, zero, zero
    for j in range(len(row)):
        entry = row[j]
        c0 += s0[j] * entry
        c1 += s1[j] * entry
        c2 += s2[j] * entry
        c3 += s3[j] * entry
        c4 += s4[j] * entry
        c5 += s5[j] * entry
    total[0, i] += c0
    total[1, i] += c1
    total[2, i] += c2 + centre[0] * c1
    total[3, i] += c3 + centre[1] * c1
    total[4, i] += c4 + centre[2] * c1
    total[5, i] += c5


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
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what nodes receive at their potentials, without a kernel that is kept.

    A box is worked on node by node, all its points at once: lists are often shorter than a
    vector register, boxes never.

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
    sums, top : (n',) float64
        s_j = Σ_i exp((f_i − c_ij − top_j)/ε) and top_j = max_i(f_i − c_ij) of these points.
    """
    indptr, indices, levels = lists
    n, kind = len(points), like[0].dtype
    first, longest = span[0] * size, 0
    count = min(n, span[1] * size) - first
    total, totals, tops = np.zeros((6, sites.shape[1])), np.empty(count), np.empty(count)
    for b in range(span[0], span[1]):
        longest = max(longest, indptr[b + 1] - indptr[b])
    block, cloud = np.empty((longest, size), kind), np.empty((4, size), kind)
    shares, own = np.empty((6, size), kind), np.empty(size, kind)
    least, sums, kept = np.empty(size, kind), np.empty(size, kind), np.empty(longest, np.int64)
    real, farthest = kind.type, kind.type(-log_cut)
    for b in range(span[0], span[1]):
        nodes, start = indices[indptr[b] : indptr[b + 1]], b * size
        held = min(n, start + size) - start
        c0, c1, c2 = centres[b, 0], centres[b, 1], centres[b, 2]
        _load(points, weight, mass, (start, held), centres[b], cloud, own)
        least[:], sums[:] = _FAR, 0.0
        for k in range(len(nodes)):
            i = nodes[k]
            x = real(sites[0, i] - c0), real(sites[1, i] - c1), real(sites[2, i] - c2)
            near, f = real(sites[6, i] / epsilon), real((sites[7, i] - levels[b]) / epsilon)
            _exponents(x, near, f, cloud, block[k], least)
        served = 0
        for k in range(len(nodes)):
            if _entries(block[k], least, farthest, sums):
                kept[served] = k
                served += 1
        _shares(cloud, own, sums, shares)
        for k in kept[:served]:
            _carry(block[k], shares, centres[b], total, nodes[k])
        for j in range(held):
            totals[start - first + j] = sums[j]
            tops[start - first + j] = levels[b] - epsilon * least[j]
    return total, totals, tops


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
