"""Spurs off."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pydantic import Field

from mdcs_pipeline.arrays import BoolArray, IntArray
from mdcs_pipeline.kernels.assignment import plan_owners
from mdcs_pipeline.kernels.ends import limb_ends
from mdcs_pipeline.kernels.spurs import shed_spurs, shed_strays
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
    cover: float = Field(
        0.15,
        ge=0,
        lt=1,
        description="Points of a limb's nodes for their size, in those of the junction that it "
        "stands on, below which the limb is a string of outliers.",
    )


class Pruned(NamedTuple):
    """Output of `Prune`."""

    rough: RoughSkeleton


class Prune(Stage[PruneSettings]):
    """Shrink strings of outliers, and ends within the thickness of what they stand on."""

    Settings = PruneSettings

    def __call__(self, cloud: MassCloud, rough: RoughSkeleton) -> Pruned:
        """Return the skeleton without strays and spurs; their junctions take over their mass."""
        owner = plan_owners(rough.plan.plan)
        counts = np.bincount(owner, minlength=len(rough.nodes))
        strays = shed_strays(rough.nodes.scale, counts, rough.edges, self.settings.cover)
        shed = gathered(rough, _free(strays, rough.nodes.fixed))
        if shed is not rough:
            rough, owner = shed, plan_owners(shed.plan.plan)
        nodes = rough.nodes
        ends = limb_ends(nodes.positions, nodes.scale, rough.edges, cloud.positions, owner)
        into = shed_spurs(nodes.positions, nodes.scale, rough.edges, ends, self.settings.length)
        return Pruned(gathered(rough, _free(into, nodes.fixed)))


def _free(into: IntArray, fixed: BoolArray) -> IntArray:
    """Return the same, but fixed nodes stay: what surrounds an update is not its to shed."""
    return np.where(fixed, np.arange(len(into)), into)
