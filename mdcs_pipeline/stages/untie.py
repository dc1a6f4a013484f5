"""Ties between limbs out."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from pydantic import Field

from mdcs_pipeline.kernels.assignment import plan_owners
from mdcs_pipeline.kernels.ties import TieRule, untied
from mdcs_pipeline.messages import MassCloud, RoughSkeleton, Surface
from mdcs_pipeline.stage import Settings, Stage

_RULE = TieRule()


class UntieSettings(Settings):
    """Settings of `Untie`."""

    noise: float = Field(
        0.1,
        ge=0,
        description="How far the surface lies from the points it was measured at, in the local "
        "radius, from which the cloud is noisy: others stay as they are.",
    )
    loop: float = Field(
        _RULE.loop,
        ge=0,
        le=1,
        description="Mass that an edge of a loop explains, in the median edge's, below which it "
        "is a tie.",
    )
    between: float = Field(
        _RULE.between,
        ge=0,
        le=1,
        description="The same for the only edge between two pieces.",
    )
    through: float = Field(
        _RULE.through,
        ge=-1,
        le=1,
        description="Least cosine between the two ways of the limb that goes on at each end of a "
        "tie.",
    )


class Untied(NamedTuple):
    """Output of `Untie`."""

    rough: RoughSkeleton


class Untie(Stage[UntieSettings]):
    """In a noisy cloud, take out edges between limbs that no points are left for."""

    Settings = UntieSettings

    def __call__(self, cloud: MassCloud, rough: RoughSkeleton, surface: Surface) -> Untied:
        """Return the skeleton without ties; as it came where the surface is where it was seen.

        The surface tells the noise: `ridge` puts it as far from the axis as its limb is thick.
        """
        nodes, settings = rough.nodes, self.settings
        moved = np.linalg.norm(surface.positions - cloud.positions, axis=1)
        # What surrounds an update is not its to judge.
        if not moved.any() or nodes.fixed.any():
            return Untied(rough)
        noise = moved / nodes.scale[plan_owners(rough.plan.plan)]
        if np.sqrt(np.mean(noise**2)) < settings.noise:
            return Untied(rough)
        rule = TieRule(settings.loop, settings.between, settings.through)
        edges = untied(cloud.positions, cloud.mass, nodes.positions, nodes.scale, rough.edges, rule)
        return Untied(replace(rough, edges=edges))
