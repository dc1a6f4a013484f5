"""Loops that the shape does not have."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from mdcs_pipeline.arrays import BoolArray
from mdcs_pipeline.errors import InputError
from mdcs_pipeline.kernels.assignment import plan_owners
from mdcs_pipeline.kernels.separation import Rings, contracted, false_loops
from mdcs_pipeline.kernels.symmetry import asymmetry, false_cycle_nodes
from mdcs_pipeline.messages import MassCloud, Nodes, RoughSkeleton, Surface, Thickness
from mdcs_pipeline.stage import Settings, Stage
from mdcs_pipeline.stages.shrink import gathered


class CheckSettings(Settings):
    """Settings of `Check`."""

    rule: Literal["symmetry", "separation"] = Field(
        "symmetry",
        description="symmetry: cycles through nodes whose mass is one-sided are false (section "
        "IV.C); separation: those whose nodes the surface leads around.",
    )
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
    hops: int = Field(
        3, ge=1, le=20, description="Width, in links of the surface, of the ring around a node."
    )
    overlap: float = Field(
        0.3,
        ge=0,
        lt=1,
        description="Overlap of two neighbours' pieces of the ring that joins them.",
    )
    majority: float = Field(
        0.5, gt=0, le=1, description="Share of a loop's nodes that must be led around."
    )
    widening: float = Field(
        1.35, gt=1, le=4, description="Growth of the radius around a false loop (separation)."
    )


class Checked(NamedTuple):
    """Outputs of `Check`: what to transport again, and the skeleton as it stands."""

    rejected: Nodes | None
    wider: Thickness | None
    accepted: RoughSkeleton


class Check(Stage[CheckSettings]):
    """Find false loops and send their nodes back at a larger scale (section IV.C)."""

    Settings = CheckSettings

    def __call__(
        self,
        cloud: MassCloud,
        rough: RoughSkeleton,
        surface: Surface | None = None,
        thickness: Thickness | None = None,
    ) -> Checked:
        """Return the nodes, and the thickness, for another transport, and the skeleton.

        By symmetry all nodes go back at a larger ε; those of false cycles lose their label.
        By separation ε stays and the radius grows, for the nodes of false loops and the
        points that they own: a loop of nodes on the wall of something thick then meets on
        its axis. In the skeleton as it stands each such loop is one node already, for when
        the rounds are used up.

        Raises
        ------
        InputError
            If the rule is separation and the surface or the thickness is not connected.
        """
        if self.settings.rule == "symmetry":
            return self._by_symmetry(cloud, rough)
        if surface is None or thickness is None:
            raise InputError(
                "the rule 'separation' needs the ports surface and thickness",
                remedy="connect both, or set check.rule to symmetry",
            )
        return self._by_separation(rough, surface, thickness)

    def _by_symmetry(self, cloud: MassCloud, rough: RoughSkeleton) -> Checked:
        settings, nodes, plan = self.settings, rough.nodes, rough.plan
        larger = plan.epsilon + settings.epsilon_step
        # Steps are added up: compare with half a step's room for round-off.
        if larger > settings.epsilon_max + 0.5 * settings.epsilon_step:
            return Checked(None, None, rough)
        imbalance = asymmetry(
            plan.plan, cloud.positions, cloud.mass, nodes.positions, settings.least_share
        )
        false = false_cycle_nodes(len(nodes), rough.edges, imbalance > settings.tau)
        if not false.any():
            return Checked(None, None, rough)
        return Checked(replace(_sent_back(nodes, false), epsilon=larger), None, rough)

    def _by_separation(
        self, rough: RoughSkeleton, surface: Surface, thickness: Thickness
    ) -> Checked:
        settings, nodes, plan = self.settings, rough.nodes, rough.plan.plan
        owner = plan_owners(plan)
        rings = Rings(surface.graph, owner, settings.hops)
        loops = false_loops(len(nodes), rough.edges, rings, settings.overlap, settings.majority)
        if not loops:
            return Checked(None, None, rough)
        false = np.zeros(len(nodes), dtype=bool)
        false[np.concatenate([np.array(loop) for loop in loops])] = True
        false &= ~nodes.fixed
        if not false.any():
            return Checked(None, None, rough)
        growth = np.where(false, settings.widening, 1.0)
        # What was widened is no measurement: a loop may be false only for as long as half of a
        # shape is seen.
        wider = replace(
            thickness,
            radius=thickness.radius * growth[owner],
            trust=None if thickness.trust is None else np.where(false[owner], 0.0, thickness.trust),
        )
        back = replace(_sent_back(nodes, false), scale=nodes.scale * growth)
        # What surrounds an update must not move: there a loop waits to be widened.
        if nodes.fixed.any():
            return Checked(back, wider, rough)
        rule = settings.hops, settings.overlap, settings.majority
        into = contracted(len(nodes), rough.edges, surface.graph, owner, *rule, loops)
        return Checked(back, wider, gathered(rough, into))


def _sent_back(nodes: Nodes, false: BoolArray) -> Nodes:
    return replace(nodes, settled=nodes.settled & ~false, rounds=nodes.rounds + 1)
