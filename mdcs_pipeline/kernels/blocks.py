"""Points and nodes put in order for the transport loops, and the kernel between them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.compiled.blocks import fill_blocks
from mdcs_pipeline.kernels.compiled.boxes import box_bounds, box_order
from mdcs_pipeline.kernels.compiled.candidates import box_lists, least_gap
from mdcs_pipeline.kernels.compiled.rows import plan_rows

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Points that share a list of nodes, and nodes that are passed over together.
BOX = 32
CELL = 16


class Boxes(NamedTuple):
    """A cloud in boxes of `BOX` points.

    Parameters
    ----------
    order : (n,) int64
        Point of each row below.
    points, weight, mass : (n, 3), (n,), (n,) float64
        y_j, 1/r_j and ϱ_j in that order.
    low, high, span : (B, 3), (B, 3), (B, 2) float64
        Bounds of places and of weights in each box.
    centres : (B, 3) float64
    """

    order: IntArray
    points: FloatArray
    weight: FloatArray
    mass: FloatArray
    low: FloatArray
    high: FloatArray
    span: FloatArray
    centres: FloatArray


class Sites(NamedTuple):
    """Nodes in cells of `CELL`.

    Parameters
    ----------
    names : (m,) int64
        Node of each column below.
    sites : (8, m) float64
        Place, place, 1/r_i and f_i.
    cells : (8, C) float64
        Lower and upper corner, least 1/r_i and largest f_i of each cell.
    """

    names: IntArray
    sites: FloatArray
    cells: FloatArray


class Blocks(NamedTuple):
    """The truncated kernel K_ij = exp((f_i − c_ij − top_j)/ε) of a cloud in boxes.

    Parameters
    ----------
    kernel : (K,) float32 or float64
        A row a point, box by box.
    starts : (B + 1,) int64
        Where boxes begin in `kernel`.
    indptr, indices : (B + 1,), (L,)
        Columns of `Sites` that each box's rows are for.
    top : (n,) float64
        max_i(f_i − c_ij).
    slack : (m,) float64
        How far each node is from being some point's best; infinite where the kernel has no
        entry of it.
    """

    kernel: NDArray[np.floating[Any]]
    starts: IntArray
    indptr: IntArray
    indices: NDArray[np.int32]
    top: FloatArray
    slack: FloatArray


def types_of(kind: type) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return empty arrays of a floating type and of the integers of its width."""
    return np.empty(0, kind), np.empty(0, np.int32 if kind is np.float32 else np.int64)


def boxed(points: FloatArray, mass: FloatArray, scale: FloatArray) -> Boxes:
    """Return the cloud in boxes.

    Parameters
    ----------
    points : (n, 3) float64
    mass, scale : (n,) float64
        ϱ_j and r_j.

    Returns
    -------
    Boxes
    """
    order = box_order(points, BOX)
    places, weight = points[order], 1.0 / scale[order]
    low, high, span = box_bounds(places, weight, BOX)
    return Boxes(order, places, weight, mass[order], low, high, span, 0.5 * (low + high))


def in_cells(nodes: FloatArray, scale: FloatArray, potentials: FloatArray) -> Sites:
    """Return the nodes in cells.

    Parameters
    ----------
    nodes : (m, 3) float64
    scale, potentials : (m,) float64
        r_i and f_i.

    Returns
    -------
    Sites
    """
    names = box_order(nodes, CELL)
    places, weight, f = nodes[names], 1.0 / scale[names], potentials[names]
    low, high, span = box_bounds(places, weight, CELL)
    most = np.maximum.reduceat(f, np.arange(0, len(f), CELL))
    sites = np.concatenate([places.T, places.T, weight[None], f[None]])
    cells = np.concatenate([low.T, high.T, span[None, :, 0], most[None]])
    return Sites(names, sites, cells)


def listed(
    boxes: Boxes, nodes: Sites, reach: float
) -> tuple[IntArray, NDArray[np.int32], FloatArray]:
    """Return for each box the columns within `reach` of a point's best, CSR, and its level."""
    return box_lists(boxes.low, boxes.high, boxes.span, nodes.sites, nodes.cells, CELL, reach)


def filled(boxes: Boxes, nodes: Sites, epsilon: float, cut: float, kind: type) -> Blocks:
    """Return the kernel with the entries below `cut` of a row's largest left out.

    Parameters
    ----------
    boxes : Boxes
    nodes : Sites
    epsilon, cut : float
    kind : type
        float32 or float64.

    Returns
    -------
    Blocks
    """
    lists = listed(boxes, nodes, -epsilon * np.log(cut))
    # More than will be used: pages that are never written to take no memory.
    most = BOX * (len(lists[1]) + 16 * len(boxes.low))
    kernel: NDArray[np.floating[Any]] = np.empty(most, kind)
    where = boxes.points, boxes.weight, BOX, boxes.centres, nodes.sites
    found = fill_blocks(*where, lists, epsilon, float(np.log(cut)), types_of(kind), kernel)
    return Blocks(kernel[: found[0][-1]], *found)


def slack_of(node: int, boxes: Boxes, nodes: Sites, blocks: Blocks) -> float:
    """Return min_j(c_ij − f_i + top_j) of a node without entries."""
    best = -blocks.top
    peaks = np.maximum.reduceat(best, np.arange(0, len(best), BOX))
    bounds = boxes.low, boxes.high, boxes.span, peaks
    return least_gap(node, nodes.sites, boxes.points, boxes.weight, best, bounds, BOX)


def plan_of(boxes: Boxes, nodes: Sites, blocks: Blocks, scaling: FloatArray) -> sparse.csr_array:
    """Return the plan u_i K_ij ϱ_j / s_j, (n, m), in the order of the points and nodes."""
    indptr, columns, data = plan_rows(
        blocks.kernel,
        blocks.starts,
        blocks.indptr,
        blocks.indices,
        BOX,
        boxes.order,
        nodes.names,
        boxes.mass,
        scaling,
    )
    shape = (len(boxes.order), len(nodes.names))
    return sparse.csr_array((data, columns, indptr), shape=shape)
