"""Spurs off."""

from __future__ import annotations

from typing import NamedTuple

from pydantic import Field

from mdcs_pipeline.kernels.assignment import plan_owners
from mdcs_pipeline.kernels.ends import limb_ends
from mdcs_pipeline.kernels.spurs import shed_spurs
from mdcs_pipeline.messages import MassCloud, RoughSkeleton
from mdcs_pipeline.stage import Settings, Stage
from mdcs_pipeline.stages.shrink import gathered


class PruneSettings(Settings):
    """Settings of `Prune`."""

    length: float = Field(
        1.2,
        ge=0,
        description="Reach of an end's points from its junction, in the junction's local radius, "
        "below which it is a spur.",
    )


class Pruned(NamedTuple):
    """Output of `Prune`."""

    rough: RoughSkeleton


class Prune(Stage[PruneSettings]):
    """Shrink ends that do not leave the thickness of what they stand on."""

    Settings = PruneSettings

    def __call__(self, cloud: MassCloud, rough: RoughSkeleton) -> Pruned:
        """Return the skeleton without spurs; their junctions take over their mass."""
        nodes, owner = rough.nodes, plan_owners(rough.plan.plan)
        ends = limb_ends(nodes.positions, nodes.scale, rough.edges, cloud.positions, owner)
        into = shed_spurs(nodes.positions, nodes.scale, rough.edges, ends, self.settings.length)
        return Pruned(gathered(rough, into))
