"""Algorithm 2: nodes and plan in turn, until the objective settles."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.blocks import Boxes
from mdcs_pipeline.kernels.energy import bending_energy
from mdcs_pipeline.kernels.problem import Accuracy, Coupling, Problem, Solution
from mdcs_pipeline.kernels.sinkhorn import couple, couple_free
from mdcs_pipeline.kernels.update import Pull, pull, relaxed_step

FloatArray = NDArray[np.float64]


class Descent(NamedTuple):
    """How Algorithm 2 steps.

    Parameters
    ----------
    power : int
        p of the node update, 1 or 2.
    step : float
        θ in (0, 1].
    max_steps : int
        Bound on updates of X.
    settle : float
        The loop ends when a step lowers the objective by less than this, in ε.
    free : bool
        Whether node masses float instead of being prescribed.
    smoothing : float
        λ of Eq. 1.
    """

    power: Literal[1, 2] = 2
    step: float = 0.1
    max_steps: int = 30
    settle: float = 1e-2
    free: bool = False
    smoothing: float = 0.0


class Optimised(NamedTuple):
    """Where Algorithm 2 ended.

    Parameters
    ----------
    problem : Problem
        With the final nodes.
    coupling : Coupling
        The plan for them; its passes are those of all steps.
    accuracy : Accuracy
        To which it was solved.
    energy : tuple of float
        The objective after each step, the first before any.
    settled : bool
        Whether the objective settled within the bound on steps.
    """

    problem: Problem
    coupling: Coupling
    accuracy: Accuracy
    energy: tuple[float, ...]
    settled: bool

    def written(self) -> Solution:
        """Return the solution with its plan, which is written out anew at every call."""
        return self.coupling.solution(self.problem.epsilon, self.accuracy)


def optimise(
    problem: Problem,
    potentials: FloatArray,
    accuracy: Accuracy,
    descent: Descent,
    smoothing: sparse.csr_array | None = None,
    fixed: NDArray[np.bool_] | None = None,
    boxes: Boxes | None = None,
) -> Optimised:
    """Minimise (1 − λ) W + λ R over nodes and plan by alternating minimisation (Algorithm 2).

    Parameters
    ----------
    problem : Problem
        With the nodes to start from.
    potentials : (m,) float64
        f to start from.
    accuracy : Accuracy
    descent : Descent
    smoothing : csr_array (m, m), optional
        The bends whose squares are R, from `kernels.bends`; needed where λ > 0.
    fixed : (m,) bool, optional
        Nodes that stay where they are.
    boxes : Boxes, optional
        Of the problem's points, from `Problem.boxes`, where they are at hand.

    Returns
    -------
    Optimised
    """
    transport = couple_free if descent.free else couple
    boxes = problem.boxes() if boxes is None else boxes
    found = transport(problem, potentials, accuracy, boxes)
    energy = [_objective(found, problem, smoothing, descent.smoothing)]
    passes, entries, settled = found.passes, found.entries, False
    for _ in range(descent.max_steps):
        pulled = _pulled(found, problem, accuracy, descent.power)
        moved = relaxed_step(problem.nodes, pulled, smoothing, descent.smoothing, descent.step)
        if fixed is not None:
            moved[fixed] = problem.nodes[fixed]
        problem = problem._replace(nodes=moved)
        found = transport(problem, found.node_potentials, accuracy, boxes)
        passes += found.passes
        entries += found.entries
        energy.append(_objective(found, problem, smoothing, descent.smoothing))
        if energy[-2] - energy[-1] < descent.settle * problem.epsilon:
            settled = True
            break
    found = found._replace(passes=passes, entries=entries)
    return Optimised(problem, found, accuracy, tuple(energy), settled)


def _pulled(found: Coupling, problem: Problem, accuracy: Accuracy, power: int) -> Pull:
    if power == 2:
        carried, scale = found.carried, problem.node_scale
        return Pull(carried.pull / scale, carried.places / scale[:, None])
    # Its weights hold distances: they are read off the plan.
    plan = found.solution(problem.epsilon, accuracy).plan
    scales = problem.point_scale, problem.node_scale
    return pull(plan, problem.points, problem.nodes, power, scales)


def _objective(
    found: Coupling, problem: Problem, smoothing: sparse.csr_array | None, weight: float
) -> float:
    if smoothing is None:
        return found.energy
    return (1.0 - weight) * found.energy + weight * bending_energy(smoothing, problem.nodes)
