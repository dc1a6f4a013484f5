"""Optimal transport between the cloud and its nodes."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mdcs_pipeline.errors import InputError
from mdcs_pipeline.kernels.blocks import Boxes
from mdcs_pipeline.kernels.optimise import Descent, Optimised, optimise
from mdcs_pipeline.kernels.problem import Accuracy, Problem
from mdcs_pipeline.messages import MassCloud, Nodes, Thickness, TransportPlan
from mdcs_pipeline.stage import Settings, Stage

_ACCURACY = Accuracy()
_DESCENT = Descent()


class TransportSettings(Settings):
    """Settings of `Transport`."""

    epsilon: float = Field(
        0.001,
        gt=0,
        description="ε of Eq. 4 (Table III), in squared unit lengths; with a thickness it has no "
        "unit and is in squares of the local radius.",
    )
    power: Literal[1, 2] = Field(
        _DESCENT.power,
        description="p of the node update: 1 draws to the median, 2 to the mean (Eq. 12).",
    )
    theta: float = Field(
        _DESCENT.step, gt=0, le=1, description="θ, relaxation of the update (Table III)."
    )
    max_steps: int = Field(
        _DESCENT.max_steps,
        ge=0,
        le=10_000,
        description="Bound on updates of the nodes; 0 only solves the plan.",
    )
    settle: float = Field(
        _DESCENT.settle,
        ge=0,
        description="Algorithm 2 ends when a step lowers the objective by less, in ε.",
    )
    marginals: Literal["balanced", "free"] = Field(
        "balanced",
        description="balanced: each node receives its mass ρ_i (Eq. 2); free: it receives what "
        "comes to it at its potential, and that becomes its mass.",
    )
    tolerance: float = Field(
        _ACCURACY.tolerance,
        gt=0,
        le=0.5,
        description="L1 error of the node marginal that ends the iteration.",
    )
    cut: float = Field(
        _ACCURACY.cut,
        gt=0,
        lt=1,
        description="Kernel entries below this share of a row's largest go.",
    )
    max_passes: int = Field(
        _ACCURACY.max_passes, ge=1, description="Bound on kernel passes a solve."
    )
    carried: Literal["surface", "centre"] = Field(
        "surface",
        description="surface: the plan carries mass from the points; centre: from the centres "
        "that the thickness holds for them, so that half a shell, or two, meet on the axis.",
    )
    precision: Literal["single", "double"] = Field(
        _ACCURACY.precision,
        description="Numbers that the kernel is kept in; single is twice as fast, double keeps "
        "the result of a balanced transport from changing with the last digits of the input.",
    )


class TransportOutput(NamedTuple):
    """Outputs of `Transport`: the plan, and the thickness that it was made with."""

    plan: TransportPlan
    thickness: Thickness | None


class Transport(Stage[TransportSettings]):
    """Move the nodes to where an entropic plan carries the cloud's mass (Algorithm 2)."""

    Settings = TransportSettings
    #: Places, masses and radii that were last put in boxes, and the boxes.
    _held: tuple[tuple[NDArray[np.float64], ...], Boxes] | None = None

    def __call__(
        self, cloud: MassCloud, nodes: Nodes, thickness: Thickness | None = None
    ) -> TransportOutput:
        """Return the plan after Algorithm 2, with the nodes where it left them.

        A thickness turns the cost into ‖x_i − y_j‖²/(r_i r_j). Potentials of the nodes that
        are not all 0 warm-start the solve.
        """
        settings = self.settings
        problem = Problem(
            carried_from(cloud, thickness, settings.carried),
            cloud.mass,
            nodes.positions,
            nodes.mass,
            settings.epsilon if nodes.epsilon is None else nodes.epsilon,
            np.ones(len(cloud)) if thickness is None else thickness.radius,
            nodes.scale if thickness is not None else np.ones(len(nodes)),
        )
        found = optimise(
            problem,
            nodes.potentials,
            Accuracy(settings.tolerance, settings.cut, settings.max_passes, settings.precision),
            Descent(
                settings.power,
                settings.theta,
                settings.max_steps,
                settings.settle,
                settings.marginals == "free",
            ),
            fixed=nodes.fixed,
            boxes=self._boxes(problem),
        )
        plan = as_plan(found, nodes, thickness, settings.marginals == "free")
        return TransportOutput(plan, thickness)

    def _boxes(self, problem: Problem) -> Boxes:
        """Return the points in boxes; rounds of merging ask again and again for the same ones."""
        of = problem.points, problem.mass, problem.point_scale
        held = self._held
        if held is None or not all(map(np.array_equal, of, held[0])):
            held = self._held = tuple(array.copy() for array in of), problem.boxes()
        return held[1]


def carried_from(
    cloud: MassCloud, thickness: Thickness | None, carried: Literal["surface", "centre"]
) -> NDArray[np.float64]:
    """Return the places, (n, 3), that the cloud's mass is carried from.

    Raises
    ------
    InputError
        If centres are asked for and no thickness holds them.
    """
    if carried == "surface":
        return cloud.positions
    if thickness is None or thickness.centre is None:
        raise InputError(
            "carried 'centre' needs a thickness with centres",
            remedy="connect the port thickness to a stage medial, or set carried to surface",
        )
    return thickness.centre


def as_plan(
    found: Optimised, nodes: Nodes, thickness: Thickness | None, free: bool
) -> TransportPlan:
    """Return the message for an optimised problem that started from `nodes`."""
    coupling, problem = found.coupling, found.problem
    received = coupling.carried.received
    scale = nodes.scale
    if thickness is not None:
        served = (received > 0) & ~nodes.fixed
        scale = np.where(served, coupling.carried.scale / np.where(served, received, 1.0), scale)
    moved = replace(
        nodes,
        positions=problem.nodes,
        mass=received / received.sum() if free else nodes.mass,
        potentials=coupling.node_potentials,
        epsilon=problem.epsilon,
        scale=scale,
    )
    return TransportPlan.late(
        lambda: found.written().plan,
        nodes=moved,
        point_potentials=coupling.point_potentials,
        epsilon=problem.epsilon,
        iterations=coupling.passes,
        marginal_error=coupling.marginal_error,
        converged=coupling.converged,
        warm=bool(np.any(nodes.potentials)),
        energy=found.energy,
        entries=coupling.entries,
    )
