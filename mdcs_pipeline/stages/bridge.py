"""Bridges over holes in the cloud."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from pydantic import Field

from mdcs_pipeline.kernels.assignment import plan_owners
from mdcs_pipeline.kernels.bridging import BridgeRule, bridges, open_ends
from mdcs_pipeline.messages import MassCloud, RoughSkeleton
from mdcs_pipeline.stage import Settings, Stage

_RULE = BridgeRule()


class BridgeSettings(Settings):
    """Settings of `Bridge`."""

    openness: float = Field(
        _RULE.openness,
        ge=0,
        le=2,
        description="Distance of an end's outermost points from its axis, in its radius, from "
        "which it is an open pipe and not a capped limb.",
    )
    reach: float = Field(
        _RULE.reach, gt=0, description="Longest bridge, in the larger end's radius."
    )
    facing: float = Field(
        _RULE.facing,
        ge=-1,
        le=1,
        description="Least cosine between two open ends and their bridge.",
    )
    aim: float = Field(
        _RULE.aim, ge=-1, le=1, description="Least cosine between an open end and a node it meets."
    )
    ratio: float = Field(
        _RULE.ratio, ge=1, description="Largest ratio of the radii of two joined ends."
    )


class Bridged(NamedTuple):
    """Output of `Bridge`."""

    rough: RoughSkeleton


class Bridge(Stage[BridgeSettings]):
    """Join the ends of limbs that a hole in the cloud has cut."""

    Settings = BridgeSettings

    def __call__(self, cloud: MassCloud, rough: RoughSkeleton) -> Bridged:
        """Return the skeleton with bridges; nodes and plan stay as they are."""
        nodes, plan = rough.nodes, rough.plan.plan
        owner = plan_owners(plan)
        ends = open_ends(nodes.positions, nodes.scale, rough.edges, cloud.positions, owner)
        rule = BridgeRule(**self.settings.model_dump())
        built = bridges(nodes.positions, rough.edges, ends, rule)
        edges = np.unique(np.concatenate([rough.edges, built]), axis=0)
        return Bridged(replace(rough, edges=edges))
