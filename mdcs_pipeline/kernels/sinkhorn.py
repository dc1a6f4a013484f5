"""Entropic optimal transport between a cloud and a few nodes (section IV.E, Eq. 9-11).

The plan is π_ij = exp((f_i + g_j − d_ij²)/ε). The kernel is local, so that entries below
`cut` of a point's largest are left out; which ones those are depends on the potentials,
and the pattern is made again whenever the potentials have moved far.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.anderson import AndersonMixer
from mdcs_pipeline.kernels.compiled.lists import best_and_slack, lists_within
from mdcs_pipeline.kernels.compiled.passes import fill_kernel, fill_plan, sinkhorn_pass

FloatArray = NDArray[np.float64]

DEPTH = 10
CLIP = 15.0
# How far, in ε, potentials may move before the pattern is made again around them.
REFILL = 10.0
# A pattern is trusted while no potential has moved by more than this many ε against another.
DRIFT = 1.0


class Accuracy(NamedTuple):
    """How exactly a transport problem is solved.

    Parameters
    ----------
    tolerance : float
        L1 distance of the node marginal from ρ that ends the iteration.
    cut : float
        Kernel entries below this share of a point's largest are left out. Total variation
        of the plan against none left out, on a torus with ε from 0.001 to 0.02: 1e-3 costs
        at most 1e-3, 1e-5 at most 1e-5, 1e-8 at most 3e-7.
    max_passes : int
        Bound on kernel passes.
    """

    tolerance: float = 1e-3
    cut: float = 1e-5
    max_passes: int = 2000


class Problem(NamedTuple):
    """A transport problem with the cost c_ij = ‖x_i − y_j‖² / (r_i r_j).

    Parameters
    ----------
    points : (n, 3) float64
        y_j.
    mass : (n,) float64
        ϱ_j > 0.
    nodes : (m, 3) float64
        x_i.
    target : (m,) float64
        ρ_i ≥ 0, of the same sum as `mass`.
    epsilon : float
        ε, in units of c.
    point_scale, node_scale : (n,), (m,) float64
        r_j and r_i; all 1 for the plain squared distance.
    """

    points: FloatArray
    mass: FloatArray
    nodes: FloatArray
    target: FloatArray
    epsilon: float
    point_scale: FloatArray
    node_scale: FloatArray


class Solution(NamedTuple):
    """A solved transport problem.

    Parameters
    ----------
    plan : scipy.sparse.csr_array, (n, m)
    node_potentials, point_potentials : (m,), (n,) float64
        f and g, in cost units.
    passes : int
    marginal_error : float
        L1 distance of the node marginal from ρ.
    converged : bool
    entries : int
        Kernel entries read, over all passes.
    """

    plan: sparse.csr_array
    node_potentials: FloatArray
    point_potentials: FloatArray
    passes: int
    marginal_error: float
    converged: bool
    entries: int


class _Pattern(NamedTuple):
    indptr: NDArray[np.int64]
    indices: NDArray[np.int32]
    costs: FloatArray


def _pattern(
    problem: Problem, potentials: FloatArray, reach: float, lift: bool
) -> tuple[_Pattern, FloatArray, NDArray[np.bool_]]:
    weights = 1.0 / problem.point_scale, 1.0 / problem.node_scale
    places = problem.points, problem.nodes
    best, slack = best_and_slack(*places, potentials, *weights)
    starved = (slack > 0.5 * reach) & lift
    if starved.any():
        # A node that serves nobody has no kernel column: raise it to where it just competes.
        potentials = potentials + np.where(starved, slack - 0.25 * reach, 0.0)
        best, _ = best_and_slack(*places, potentials, *weights)
    pattern = _Pattern(*lists_within(*places, potentials, *weights, best, reach))
    return pattern, potentials, starved


def _drift(log_scaling: FloatArray, lifted: NDArray[np.bool_]) -> float:
    """Return by how many ε a potential has risen against another since the pattern was made.

    The way back down of a lifted node does not count. It is no point's best, so that the
    other columns do not depend on it; and a node of little mass, lifted every time, would
    have the pattern made again for ever.
    """
    return float(log_scaling.max() - log_scaling[~lifted].min())


class _Run(NamedTuple):
    log_scaling: FloatArray
    sums: FloatArray
    passes: int
    error: float


def _iterate(
    pattern: _Pattern,
    kernel: FloatArray,
    lifted: NDArray[np.bool_],
    problem: Problem,
    accuracy: Accuracy,
    budget: int,
) -> _Run:
    """Run accelerated passes until the marginal is met, the potentials are far or `budget` ends."""
    mass, target = problem.mass, problem.target
    z = np.zeros(len(target))
    best_z, best_error = z, np.inf
    received, sums = np.empty(len(target)), np.empty(len(mass))
    mixer = AndersonMixer(target, DEPTH, CLIP)
    passes = 0
    while True:
        sinkhorn_pass(pattern.indptr, pattern.indices, kernel, mass, np.exp(z), received, sums)
        passes += 1
        error = float(np.abs(received - target).sum())
        if error <= accuracy.tolerance or passes >= budget or _drift(z, lifted) > REFILL:
            return _Run(z, sums, passes, error)
        residual = np.log(target) - np.log(np.maximum(received, 1e-300))
        if error > 2.0 * best_error:
            mixer.clear()
            z, best_error = best_z, np.inf
            continue
        if error < best_error:
            best_z, best_error = z + residual, error
        z = mixer.step(z, residual)


def solve(problem: Problem, potentials: FloatArray, accuracy: Accuracy) -> Solution:
    """Solve Eq. 9 by stabilised, accelerated Sinkhorn iterations.

    Parameters
    ----------
    problem : Problem
        Every target ρ_i must be positive.
    potentials : (m,) float64
        f to start from; zeros for a cold start.
    accuracy : Accuracy

    Returns
    -------
    Solution
        Its point marginal is exact, its node marginal within the tolerance where it converged.
    """
    reach = -problem.epsilon * np.log(accuracy.cut)
    passes = entries = 0
    while True:
        pattern, start, lifted = _pattern(problem, potentials, reach, lift=True)
        kernel, top = fill_kernel(*pattern, start, problem.epsilon)
        budget = accuracy.max_passes - passes
        run = _iterate(pattern, kernel, lifted, problem, accuracy, budget)
        passes += run.passes
        entries += run.passes * len(kernel)
        potentials = start + problem.epsilon * run.log_scaling
        trusted = _drift(run.log_scaling, lifted) <= DRIFT
        if passes >= accuracy.max_passes or (run.error <= accuracy.tolerance and trusted):
            break
    return _solution(problem, pattern, kernel, top, run, potentials)._replace(
        passes=passes, converged=run.error <= accuracy.tolerance, entries=entries
    )


def solve_free(problem: Problem, potentials: FloatArray, accuracy: Accuracy) -> Solution:
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
        Only its `cut` is read.

    Returns
    -------
    Solution
    """
    reach = -problem.epsilon * np.log(accuracy.cut)
    pattern, _, _ = _pattern(problem, potentials, reach, lift=False)
    kernel, top = fill_kernel(*pattern, potentials, problem.epsilon)
    received, sums = np.empty(len(problem.nodes)), np.empty(len(problem.mass))
    ones = np.ones(len(problem.nodes))
    sinkhorn_pass(pattern.indptr, pattern.indices, kernel, problem.mass, ones, received, sums)
    run = _Run(np.zeros(len(ones)), sums, 1, 0.0)
    return _solution(problem, pattern, kernel, top, run, potentials)


def _solution(
    problem: Problem,
    pattern: _Pattern,
    kernel: FloatArray,
    top: FloatArray,
    run: _Run,
    potentials: FloatArray,
) -> Solution:
    data = fill_plan(
        pattern.indptr, pattern.indices, kernel, problem.mass, np.exp(run.log_scaling), run.sums
    )
    shape = (len(problem.mass), len(problem.nodes))
    return Solution(
        plan=sparse.csr_array((data, pattern.indices, pattern.indptr), shape=shape),
        node_potentials=potentials,
        point_potentials=problem.epsilon * np.log(problem.mass / run.sums) - top,
        passes=run.passes,
        marginal_error=run.error,
        converged=True,
        entries=len(kernel),
    )
