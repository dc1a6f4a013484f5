"""Bridges over holes in the cloud."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from pydantic import Field

from mdcs_pipeline.kernels.assignment import plan_owners
from mdcs_pipeline.kernels.bridging import BridgeRule, bridges
from mdcs_pipeline.kernels.ends import limb_ends
from mdcs_pipeline.kernels.nearest import nearest
from mdcs_pipeline.kernels.rims import free_angle
from mdcs_pipeline.kernels.shore import Shore
from mdcs_pipeline.messages import MassCloud, RoughSkeleton
from mdcs_pipeline.stage import Settings, Stage

_RULE = BridgeRule()


class BridgeSettings(Settings):
    """Settings of `Bridge`."""

    neighbours: int = Field(
        12, ge=4, le=100, description="Nearest points that a point must have all around it."
    )
    gap: float = Field(
        2.2, gt=0, le=6.3, description="Angle free of neighbours, in radians, that makes a rim."
    )
    openness: float = Field(
        _RULE.openness,
        ge=0,
        le=1,
        description="Share of rim points among an end's outermost from which it is cut open; of "
        "two that face each other the mean.",
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
    aim_within: float = Field(
        _RULE.aim_within,
        ge=-1,
        le=1,
        description="The same where the node belongs to the end's own piece: a loop is closed.",
    )
    ratio: float = Field(
        _RULE.ratio, ge=1, description="Largest ratio of the radii of two joined ends."
    )
    girth: float = Field(
        _RULE.girth,
        ge=0,
        description="Least radius of two ends that face each other, in their local radius.",
    )
    girth_aim: float = Field(
        _RULE.girth_aim,
        ge=0,
        description="The same for an end that aims at its own piece.",
    )
    crowd: float = Field(
        _RULE.crowd,
        ge=0,
        description="Points in the way between two ends, in those of an end, from which it is "
        "refused.",
    )
    crowd_aim: float = Field(
        _RULE.crowd_aim, ge=0, description="The same where an end aims at what does not face it."
    )
    onward: float = Field(
        _RULE.onward,
        ge=-1,
        le=1,
        description="Mean cosine of two ends' courses and their bridge from which one limb goes "
        "on over it; from those that meet at a sharper angle other pieces are still looked for.",
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
        owner, points, settings = plan_owners(plan), cloud.positions, self.settings
        free = free_angle(points, nearest(points, settings.neighbours).indices)
        shore = Shore.around(nodes.positions, nodes.scale, points, owner)
        ends = limb_ends(
            nodes.positions, nodes.scale, rough.edges, points, owner, free > settings.gap
        )
        rule = BridgeRule(**settings.model_dump(exclude={"neighbours", "gap"}))
        built = bridges(rough.edges, ends, shore, rule)
        edges = np.unique(np.concatenate([rough.edges, built]), axis=0)
        return Bridged(replace(rough, edges=edges))
