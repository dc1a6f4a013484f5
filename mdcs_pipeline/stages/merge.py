"""Merging of nodes that do not stand on a line yet."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from mdcs_pipeline.arrays import BoolArray, IntArray
from mdcs_pipeline.kernels.compiled.shares import top_shares
from mdcs_pipeline.kernels.labels import LineRule, line_like, skeletal_nodes
from mdcs_pipeline.kernels.links import Links, named_pairs, shared_mass, unique_pairs
from mdcs_pipeline.kernels.merging import close_pairs, inherited, merge, merging_pairs
from mdcs_pipeline.messages import Nodes, TransportPlan
from mdcs_pipeline.stage import Settings, Stage

_RULE = LineRule()


class MergeSettings(Settings):
    """Settings of `Merge`."""

    rule: Literal["line_like", "spacing"] = Field(
        "line_like",
        description="line_like: nodes merge until their points' mass goes to line-like "
        "structures (section IV.B); spacing: until no two are closer than their local radius.",
    )
    two_share: float = Field(
        _RULE.two_share,
        gt=0.5,
        le=1,
        description="A point whose two largest shares together exceed this is line-like (IV.B).",
    )
    cosine: float = Field(
        _RULE.cosine,
        ge=-1,
        le=0,
        description="Or whose three nodes stand at most at this cosine (IV.B).",
    )
    majority: float = Field(
        _RULE.majority,
        gt=0,
        le=1,
        description="Line-like share of a skeletal node's points (IV.B).",
    )
    noise: float = Field(
        0.1, ge=0, lt=1, description="Least shared mass of a connection, relative to both (IV.B)."
    )
    least_share: float = Field(
        0.01, ge=0, lt=1, description="Share from which a point counts as serving a node (IV.C)."
    )
    spacing: float = Field(
        1.0, gt=0, le=4, description="Least distance of two nodes in the smaller local radius."
    )
    persistence: float = Field(
        1.0,
        gt=0,
        le=1,
        description="Factor to the spacing for two nodes that were settled when the update "
        "began: under 1, what stands does not merge for a small change of its surroundings.",
    )


class Merging(NamedTuple):
    """Outputs of `Merge`: nodes to transport again, and the plan as labelled so far."""

    unsettled: Nodes | None
    plan: TransportPlan


class Merge(Stage[MergeSettings]):
    """Label the skeletal nodes and merge pairs of the others (section IV.B)."""

    Settings = MergeSettings

    def __call__(self, plan: TransportPlan) -> Merging:
        """Return the merged nodes, if any merged, and the plan with labels and connections."""
        if self.settings.rule == "spacing":
            return self._by_spacing(plan)
        return self._by_lines(plan)

    def _by_lines(self, plan: TransportPlan) -> Merging:
        nodes, settings = plan.nodes, self.settings
        top, shares = top_shares(plan.plan.indptr, plan.plan.indices, plan.plan.data, 3)
        rule = LineRule(settings.two_share, settings.cosine, settings.majority)
        lines = line_like(nodes.positions, top, shares, rule)
        fresh = skeletal_nodes(len(nodes), top[:, 0], lines, rule.majority)
        named = named_pairs(top, shares, settings.two_share)
        links = unique_pairs(np.concatenate([nodes.links, named]))
        links = _carried(links, shared_mass(plan.plan, settings.least_share), nodes, settings.noise)
        labelled = replace(nodes, settled=nodes.settled | fresh, links=links)
        pairs = merging_pairs(nodes.positions, nodes.mass, labelled.settled, links)
        return _outcome(plan, labelled, pairs)

    def _by_spacing(self, plan: TransportPlan) -> Merging:
        nodes = plan.nodes
        stands = self.settings.persistence
        widths = np.where(nodes.settled, stands, 1.0) if stands < 1.0 else None
        pairs = close_pairs(
            nodes.positions, nodes.scale, self.settings.spacing, nodes.fixed, widths
        )
        settled = np.ones(len(nodes), dtype=bool)
        settled[pairs.ravel()] = False
        labelled = plan.serving(replace(nodes, settled=settled))
        if not len(pairs):
            return Merging(None, labelled)
        merged = merged_nodes(nodes, pairs)
        if stands < 1.0:
            # What a settled node takes in does not make it a new one.
            kept = np.isin(merged.ids, nodes.ids[nodes.settled])
            merged = replace(merged, settled=kept)
        return Merging(merged, labelled)


def _carried(links: IntArray, shared: Links, nodes: Nodes, noise: float) -> IntArray:
    """Return the links that pass the noise check: enough mass goes to both nodes."""
    both = nodes.mass[shared.pairs].sum(axis=1)
    passed = shared.pairs[shared.strength >= noise * both]
    count = len(nodes)
    kept = np.isin(links @ [count, 1], passed @ [count, 1])
    return links[kept]


def _outcome(plan: TransportPlan, labelled: Nodes, pairs: IntArray) -> Merging:
    settled_plan = plan.serving(labelled)
    if not len(pairs):
        return Merging(None, settled_plan)
    return Merging(merged_nodes(labelled, pairs), settled_plan)


def merged_nodes(nodes: Nodes, pairs: IntArray) -> Nodes:
    """Return the nodes after merging disjoint pairs: mass and scale are carried over.

    A fixed node, which is the first of its pair, stays what it is.
    """
    merged = merge(nodes.positions, nodes.mass, pairs)
    settled: BoolArray = nodes.settled.copy()
    settled[pairs.ravel()] = False
    scale = nodes.scale.copy()
    moving = pairs[~nodes.fixed[pairs[:, 0]]]
    scale[moving[:, 0]] = nodes.scale[moving].mean(axis=1)
    fixed = nodes.fixed[merged.kept]
    positions = np.where(fixed[:, None], nodes.positions[merged.kept], merged.positions)
    return Nodes(
        positions,
        merged.mass / merged.mass.sum(),
        nodes.potentials[merged.kept],
        nodes.epsilon,
        nodes.ids[merged.kept],
        inherited(nodes.links, merged.into),
        settled[merged.kept],
        scale[merged.kept],
        nodes.rounds,
        fixed,
        nodes.beyond[merged.kept],
        nodes.header,
    )
