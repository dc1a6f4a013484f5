"""Edges between the nodes of a plan."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field
from scipy import sparse

from mdcs_pipeline.arrays import IntArray
from mdcs_pipeline.kernels.compiled.shares import top_shares
from mdcs_pipeline.kernels.contact import bodies_touch, contacts, relative_contact
from mdcs_pipeline.kernels.fallen import bodies
from mdcs_pipeline.kernels.links import (
    Links,
    co_transport,
    gone_on,
    straight_ahead,
    unique_pairs,
    widened,
)
from mdcs_pipeline.kernels.nerve import COMMON_POINTS, LEAST_SHARE, filled_triangles, open_triangles
from mdcs_pipeline.kernels.spanning import spanning_links
from mdcs_pipeline.messages import MassCloud, Nodes, RoughSkeleton, Surface, TransportPlan
from mdcs_pipeline.stage import Settings, Stage


class LinkSettings(Settings):
    """Settings of `Link`."""

    rule: Literal["kept", "co_transport"] = Field(
        "kept",
        description="kept: the connections that merging kept (section IV.B); co_transport: "
        "nodes that share mass through common points, without the triangles that these fill.",
    )
    widening: float = Field(
        2.0, ge=1, le=10, description="ε of the plan that links are read from, in the plan's own."
    )
    strength: float = Field(
        0.1, ge=0, lt=1, description="Least co-transported mass, relative to the smaller node's."
    )
    contact: float = Field(
        0.15,
        ge=0,
        le=1,
        description="Least contact of two nodes' points on the surface, relative to the smaller "
        "of their largest contacts; used where a surface is given.",
    )
    body: float = Field(
        0.7,
        gt=0,
        le=1,
        description="Points of a connected part of a node's, relative to the largest, from which "
        "it is no stray: strays make no loops.",
    )
    joining: float = Field(
        0.01,
        ge=0,
        lt=1,
        description="Least strength of a link that joins two pieces; weaker ones carry no mass.",
    )
    joining_contact: float = Field(
        0.0,
        ge=0,
        le=1,
        description="The same as contact, for a link that joins two pieces from their sides.",
    )
    joining_ahead: float = Field(
        0.5,
        ge=-1,
        le=1,
        description="Least cosine between an end and a link that goes on from it: such a link "
        "joins two pieces over any contact. Also of the less straight of two ends that face each "
        "other: they are joined over a weaker link, too.",
    )
    onward: float = Field(
        0.7,
        ge=-1,
        le=1,
        description="Least cosine between an end and a strong link that goes on from it: such a "
        "link needs no more than a touch, within a piece, too; and none where it joins the ends of "
        "two pieces.",
    )
    least_share: float = Field(
        LEAST_SHARE,
        ge=0,
        lt=1,
        description="Share from which a point counts as serving a node (IV.C).",
    )
    common_points: int = Field(
        COMMON_POINTS, ge=1, description="Common points of three nodes that fill their triangle."
    )


class LinkOutput(NamedTuple):
    """Output of `Link`."""

    rough: RoughSkeleton


class Link(Stage[LinkSettings]):
    """Connect the nodes whose points share their mass."""

    Settings = LinkSettings

    def __call__(
        self, cloud: MassCloud, plan: TransportPlan, surface: Surface | None = None
    ) -> LinkOutput:
        """Return the rough skeleton: the plan, its nodes' edges and labels.

        With a surface, nodes must touch on it to be linked: what is close only through the
        air stays apart.
        """
        if self.settings.rule == "kept":
            edges = plan.nodes.links
        else:
            edges = self._by_mass(cloud, plan, surface)
        return LinkOutput(RoughSkeleton(plan, edges, plan.nodes.settled))

    def _by_mass(self, cloud: MassCloud, plan: TransportPlan, surface: Surface | None) -> IntArray:
        settings, nodes = self.settings, plan.nodes
        wide = widened(plan.plan, cloud.mass, settings.widening)
        links = co_transport(wide, cloud.mass, 1e-3)
        top, shares = top_shares(plan.plan.indptr, plan.plan.indices, plan.plan.data, 6)
        strong = links.strength > settings.strength
        near = firm = np.ones(len(links.pairs))
        touching = None
        if surface is not None:
            owner = top[:, 0]
            touching = contacts(surface.graph, owner, len(nodes))
            near = relative_contact(touching, links.pairs)
            body = bodies(surface.graph, owner, settings.body)
            firm = near * bodies_touch(surface.graph, owner, body, links.pairs)
        filled = filled_triangles(top, shares, settings.least_share, settings.common_points)
        shared = strong & (firm >= settings.contact)
        edges = open_triangles(nodes.positions, links.pairs[shared], filled)
        if nodes.fixed.any():
            # What surrounds an update is not its to judge.
            edges = unique_pairs(
                np.concatenate([edges[~nodes.fixed[edges].all(axis=1)], _kept(nodes)])
            )
        # Little may show of a limb's root, and still it goes on into what it touches.
        # Nodes may settle so far apart on a limb that they share next to nothing: what is too weak
        # for a link is one where both its nodes are ends and face each other.
        weak = ~strong & (links.strength >= settings.joining) & (firm >= settings.joining_contact)
        open_to = ((strong & (firm > 0)) | weak) & ~nodes.fixed[links.pairs].any(axis=1)
        least = np.full((len(weak), 2), settings.onward)
        least[:, 1] = np.where(weak, settings.joining_ahead, -1.0)
        onward = Links(links.pairs[open_to], links.strength[open_to])
        edges = gone_on(nodes.positions, edges, onward, least[open_to])
        # Strands side by side share mass, and stray points of theirs are neighbours.
        ahead = straight_ahead(nodes.positions, edges, links.pairs)
        aimed = ahead.max(axis=1) >= settings.joining_ahead
        touch = (near > 0) & ((near >= settings.joining_contact) | aimed)
        # Sampling in rings may leave a limb in pieces that share mass and face each other.
        facing = np.isin(links.pairs, edges).all(axis=1) & (ahead.min(axis=1) >= settings.onward)
        touch |= strong & facing
        joining = Links(links.pairs[touch], links.strength[touch])
        if touching is not None:
            joining = self._with_contacts(joining, touching)
        ways = _ways_beyond(nodes)
        spanned = spanning_links(
            len(nodes), unique_pairs(np.concatenate([edges, ways])), joining, settings.joining
        )
        return _without(spanned, ways, edges)

    def _with_contacts(self, links: Links, touching: sparse.csr_array) -> Links:
        """Return the links, and weakest of all the pairs that only touch on the surface.

        What hangs together on the surface is one piece, even where gaps in the sampling are
        wider than the plan reaches.
        """
        upper = sparse.coo_array(sparse.triu(touching, k=1))
        pairs = np.stack([upper.row, upper.col], axis=1).astype(np.int64)
        firm = pairs[relative_contact(touching, pairs) >= self.settings.contact]
        strength = np.full(len(firm), self.settings.joining)
        return Links(
            np.concatenate([links.pairs, firm]), np.concatenate([links.strength, strength])
        )


def _kept(nodes: Nodes) -> IntArray:
    return nodes.links[nodes.fixed[nodes.links].all(axis=1)]


def _ways_beyond(nodes: Nodes) -> IntArray:
    """Return pairs of fixed nodes that hang together outside: no link must join them again."""
    joined = np.flatnonzero(nodes.beyond >= 0)
    joined = joined[np.argsort(nodes.beyond[joined], kind="stable")]
    pairs = np.stack([joined[:-1], joined[1:]], axis=1)
    alike = nodes.beyond[pairs[:, 0]] == nodes.beyond[pairs[:, 1]]
    return np.sort(pairs[alike], axis=1)


def _without(spanned: IntArray, ways: IntArray, edges: IntArray) -> IntArray:
    """Return the edges that were there or were added, but not the ways that lead outside."""
    if not len(ways):
        return spanned
    real = {tuple(pair) for pair in edges.tolist()}
    only = {tuple(pair) for pair in ways.tolist()} - real
    return np.array(
        [pair for pair in spanned.tolist() if tuple(pair) not in only], dtype=np.int64
    ).reshape(-1, 2)
