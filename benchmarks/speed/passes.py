"""Passes with and without acceleration, and what accuracy costs."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from benchmarks.speed.problems import transport_problem
from mdcs_pipeline.kernels.blocks import BOX, filled, in_cells
from mdcs_pipeline.kernels.compiled.balance import sinkhorn_pass
from mdcs_pipeline.kernels.problem import Accuracy, Problem
from mdcs_pipeline.kernels.sinkhorn import couple, solve

EXACT = Accuracy(1e-10, 1e-14, 20_000)


def plain_passes(problem: Problem, tolerances: tuple[float, ...], bound: int) -> list[int]:
    """Return the passes of Sinkhorn without acceleration down to each tolerance."""
    boxes, count = problem.boxes(), len(problem.nodes)
    z, needed, passes = np.zeros(count), [], 0
    received, sums = np.empty(count), np.empty(len(problem.mass))
    shift = np.zeros(count)
    while len(needed) < len(tolerances) and passes < bound:
        sites = in_cells(problem.nodes, problem.node_scale, problem.epsilon * shift)
        blocks = filled(boxes, sites, problem.epsilon, 1e-9, np.float64)
        where = blocks.kernel, blocks.starts, blocks.indptr, blocks.indices, BOX, boxes.mass
        target, z = problem.target[sites.names], np.zeros(count)
        while len(needed) < len(tolerances) and passes < bound and np.ptp(z) < 5.0:
            sinkhorn_pass(*where, np.exp(z), received, sums)
            passes += 1
            error = np.abs(received - target).sum()
            while len(needed) < len(tolerances) and error <= tolerances[len(needed)]:
                needed.append(passes)
            z += np.log(target / np.maximum(received, 1e-300))
        shift[sites.names] += z
    return needed + [bound] * (len(tolerances) - len(needed))


class Compared(NamedTuple):
    """Passes to 1e-3 and 1e-6 on one problem."""

    plain: list[int]
    ours: list[int]
    converged: bool


def compare(count: int = 20) -> list[Compared]:
    """Return the passes of both on problems of several sizes, ε and seeds."""
    rows = []
    for seed in range(count):
        problem = transport_problem(4000, 400, (0.001, 0.002)[seed % 2], seed)
        plain = plain_passes(problem, (1e-3, 1e-6), 20_000)
        made = [
            couple(problem, np.zeros(400), Accuracy(tolerance, 1e-9, 2000))
            for tolerance in (1e-3, 1e-6)
        ]
        done = all(one.converged for one in made)
        rows.append(Compared(plain, [one.passes for one in made], done))
    return rows


def accuracy_table(repeats: int) -> list[tuple[float, float, float, float, int]]:
    """Return (tolerance, cut, L1 error of the plan, CPU seconds, passes)."""
    problem = transport_problem()
    start = np.zeros(len(problem.nodes))
    exact = solve(problem, start, EXACT).plan
    rows = []
    for tolerance in (1e-2, 1e-3, 1e-4, 1e-5):
        for cut in (1e-3, 1e-4, 1e-5, 1e-6, 1e-9):
            accuracy = Accuracy(tolerance, cut, 5000)
            error = float(abs(solve(problem, start, accuracy).plan - exact).sum())
            seconds, passes = [], 0
            for _ in range(repeats):
                began = time.process_time()
                passes = couple(problem, start, accuracy).passes
                seconds.append(time.process_time() - began)
            rows.append((tolerance, cut, error, float(np.median(seconds)), passes))
    return rows
