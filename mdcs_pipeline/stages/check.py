"""Loops that the shape does not have."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from pydantic import Field

from mdcs_pipeline.kernels.symmetry import asymmetry, false_cycle_nodes
from mdcs_pipeline.messages import MassCloud, Nodes, RoughSkeleton
from mdcs_pipeline.stage import Settings, Stage


class CheckSettings(Settings):
    """Settings of `Check`."""

    tau: float = Field(
        0.15, gt=0, le=1, description="τ, imbalance from which a node is a candidate (Table III)."
    )
    epsilon_step: float = Field(
        0.0002, gt=0, description="Δε, growth of ε for what is sent back (Table III)."
    )
    epsilon_max: float = Field(
        0.002, gt=0, description="ε at which nothing is sent back any more (section IV.C)."
    )
    least_share: float = Field(
        0.01, ge=0, lt=1, description="Share from which a point counts as serving a node (IV.C)."
    )


class Checked(NamedTuple):
    """Outputs of `Check`: nodes to transport again, and the skeleton as it stands."""

    rejected: Nodes | None
    accepted: RoughSkeleton


class Check(Stage[CheckSettings]):
    """Find false cycles by the symmetry of the plan around their nodes (section IV.C)."""

    Settings = CheckSettings

    def __call__(self, cloud: MassCloud, rough: RoughSkeleton) -> Checked:
        """Return the nodes for a larger ε if any cycle is false, and the skeleton.

        The nodes of false cycles lose their label; all others keep it.
        """
        settings, nodes, plan = self.settings, rough.nodes, rough.plan
        larger = plan.epsilon + settings.epsilon_step
        # Steps are added up: compare with half a step's room for round-off.
        if larger > settings.epsilon_max + 0.5 * settings.epsilon_step:
            return Checked(None, rough)
        imbalance = asymmetry(
            plan.plan, cloud.positions, cloud.mass, nodes.positions, settings.least_share
        )
        false = false_cycle_nodes(len(nodes), rough.edges, imbalance > settings.tau)
        if not false.any():
            return Checked(None, rough)
        back = replace(
            nodes, epsilon=larger, settled=nodes.settled & ~false, rounds=nodes.rounds + 1
        )
        return Checked(back, rough)
