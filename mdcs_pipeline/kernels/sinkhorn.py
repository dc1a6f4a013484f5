"""Entropic optimal transport between a cloud and a few nodes (section IV.E, Eq. 9-11).

The plan is π_ij = exp((f_i + g_j − c_ij)/ε). The kernel is local, so that entries below
`cut` of a point's largest are left out; which ones those are depends on the potentials,
and the kernel is made again whenever the potentials have moved far.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.blocks import (
    BOX,
    Blocks,
    Boxes,
    Sites,
    filled,
    in_cells,
    listed,
    slack_of,
    types_of,
)
from mdcs_pipeline.kernels.compiled.balance import drift, iterate
from mdcs_pipeline.kernels.compiled.carried import carried_by_blocks, free_boxes
from mdcs_pipeline.kernels.problem import Accuracy, Carried, Coupling, Problem, Solution

FloatArray = NDArray[np.float64]

DEPTH = 25
CLIP = 15.0
# How far, in ε, potentials may move before the kernel is made again around them.
REFILL = 10.0
# A kernel is trusted while no potential has moved by more than this many ε against another.
DRIFT = 1.0


def _in_place(total: FloatArray, names: NDArray[np.int64]) -> Carried:
    ordered = np.empty_like(total)
    ordered[:, names] = total
    return Carried(ordered[0], ordered[1], ordered[2:5].T.copy(), ordered[5])


def _scattered(values: FloatArray, order: NDArray[np.int64]) -> FloatArray:
    result = np.empty_like(values)
    result[order] = values
    return result


class _Start(NamedTuple):
    sites: Sites
    blocks: Blocks
    potentials: FloatArray
    lifted: NDArray[np.bool_]


def _start(problem: Problem, boxes: Boxes, potentials: FloatArray, accuracy: Accuracy) -> _Start:
    """Return the kernel around the potentials, those of starved nodes raised."""
    how = problem.epsilon, accuracy.cut, accuracy.kind
    reach = -problem.epsilon * np.log(accuracy.cut)
    sites = in_cells(problem.nodes, problem.node_scale, potentials)
    blocks = filled(boxes, sites, *how)
    slack = blocks.slack
    for i in np.flatnonzero(~np.isfinite(slack)):
        slack[i] = slack_of(int(i), boxes, sites, blocks)
    starved = slack > 0.5 * reach
    if starved.any():
        # A node that serves nobody has no kernel column: raise it to where it just competes.
        lift = np.where(starved, slack - 0.25 * reach, 0.0)
        potentials = potentials + _scattered(lift, sites.names)
        sites = in_cells(problem.nodes, problem.node_scale, potentials)
        blocks = filled(boxes, sites, *how)
    return _Start(sites, blocks, potentials, starved)


def couple(
    problem: Problem, potentials: FloatArray, accuracy: Accuracy, boxes: Boxes | None = None
) -> Coupling:
    """Solve Eq. 9 by stabilised, accelerated Sinkhorn iterations.

    Parameters
    ----------
    problem : Problem
        Every target ρ_i must be positive.
    potentials : (m,) float64
        f to start from; zeros for a cold start.
    accuracy : Accuracy
    boxes : Boxes, optional
        Of the problem's points, from `Problem.boxes`, where they are at hand.

    Returns
    -------
    Coupling
        Its point marginal is exact, its node marginal within the tolerance where it converged.
    """
    boxes = problem.boxes() if boxes is None else boxes
    passes = entries = held = 0
    error = before = np.inf
    count = len(potentials)
    # More steps than there are unknowns say nothing more.
    depth = min(DEPTH, max(10, count // 4))
    memory = np.zeros((depth + 1, count)), np.zeros((depth + 1, count)), np.zeros((depth, depth))
    z = np.zeros(count)
    while True:
        sites, blocks, start, lifted = _start(problem, boxes, potentials, accuracy)
        names = sites.names
        # Steps before are remembered from where scalings now count, unless nodes were raised
        # or those steps have led nowhere.
        held = 0 if lifted.any() or error >= before else held
        before = error
        memory[0][depth] -= z
        where = blocks.kernel, blocks.starts, blocks.indptr, blocks.indices, BOX
        target = problem.target[names]
        budget = accuracy.max_passes - passes
        limits = accuracy.tolerance, budget, REFILL, CLIP
        z, sums, used, error, held = iterate(
            *where, boxes.mass, target, lifted, *limits, memory, held
        )
        passes += used
        entries += used * len(blocks.kernel)
        potentials = start + problem.epsilon * _scattered(z, names)
        trusted = drift(z, lifted) <= DRIFT
        if passes >= accuracy.max_passes or (error <= accuracy.tolerance and trusted):
            break
    cloud = boxes.points, boxes.weight, boxes.mass, BOX, boxes.centres
    scaling = np.exp(z)
    total = carried_by_blocks(*cloud, *where[:4], scaling, sums)
    g = problem.epsilon * np.log(boxes.mass / sums) - blocks.top
    return Coupling(
        boxes,
        sites,
        blocks,
        scaling,
        _in_place(total, names),
        potentials,
        _scattered(g, boxes.order),
        passes,
        error,
        error <= accuracy.tolerance,
        entries,
    )


def couple_free(
    problem: Problem, potentials: FloatArray, accuracy: Accuracy, boxes: Boxes | None = None
) -> Coupling:
    """Solve Eq. 9 without its node marginal: every node takes what comes at its potential.

    This is the limit of a relaxed node marginal, τ KL(Π1 | ρ), for τ → 0. It has a closed
    form: π_ij = ϱ_j exp((f_i − c_ij)/ε) / Σ_k exp((f_k − c_kj)/ε).

    Parameters
    ----------
    problem : Problem
        `target` is not read.
    potentials : (m,) float64
        f, which stays as it is.
    accuracy : Accuracy
        Only `cut`, and `tolerance` for the digits to compute in, are read.
    boxes : Boxes, optional
        As in `couple`.

    Returns
    -------
    Coupling
    """
    boxes = problem.boxes() if boxes is None else boxes
    epsilon, log_cut = problem.epsilon, float(np.log(accuracy.cut))
    sites = in_cells(problem.nodes, problem.node_scale, potentials)
    lists = listed(boxes, sites, -epsilon * log_cut)
    cloud = boxes.points, boxes.weight, boxes.mass, BOX, boxes.centres
    span, like = (0, len(boxes.low)), types_of(accuracy.kind)
    total, sums, top = free_boxes(*cloud, sites.sites, lists, epsilon, log_cut, span, like)
    g = epsilon * np.log(boxes.mass / sums) - top
    return Coupling(
        boxes,
        sites,
        None,
        np.ones(len(potentials)),
        _in_place(total, sites.names),
        potentials,
        _scattered(g, boxes.order),
        1,
        0.0,
        True,
        BOX * len(lists[1]),
    )


def solve(problem: Problem, potentials: FloatArray, accuracy: Accuracy) -> Solution:
    """Return the solution of `couple` with its plan."""
    return couple(problem, potentials, accuracy).solution(problem.epsilon, accuracy)


def solve_free(problem: Problem, potentials: FloatArray, accuracy: Accuracy) -> Solution:
    """Return the solution of `couple_free` with its plan."""
    return couple_free(problem, potentials, accuracy).solution(problem.epsilon, accuracy)
