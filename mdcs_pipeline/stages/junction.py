"""Junctions where limbs meet."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import sparse

from mdcs_pipeline.kernels.compiled.shares import top_shares
from mdcs_pipeline.kernels.contact import contacts, relative_contact
from mdcs_pipeline.kernels.junctions import Parted, meeting_places, parted
from mdcs_pipeline.kernels.nerve import COMMON_POINTS, LEAST_SHARE, filled_triangles
from mdcs_pipeline.messages import MassCloud, RoughSkeleton, Surface, Thickness
from mdcs_pipeline.stage import Settings, Stage


class JunctionSettings(Settings):
    """Settings of `Junction`."""

    contact: float = Field(
        0.1,
        ge=0,
        le=1,
        description="Least contact of two nodes' points on the surface, relative to the smaller "
        "of their largest contacts, from which they leave a third together.",
    )
    least_share: float = Field(
        LEAST_SHARE,
        ge=0,
        lt=1,
        description="Share from which a point counts as serving a node (IV.C).",
    )
    common_points: int = Field(
        COMMON_POINTS, ge=1, description="Common points of three nodes from which they meet."
    )


class Joint(NamedTuple):
    """Output of `Junction`."""

    rough: RoughSkeleton


class Junction(Stage[JunctionSettings]):
    """Give limbs that leave a node together a junction where they part."""

    Settings = JunctionSettings

    def __call__(
        self,
        cloud: MassCloud,
        rough: RoughSkeleton,
        surface: Surface,
        thickness: Thickness | None = None,
    ) -> Joint:
        """Return the skeleton with the nodes that such limbs meet in.

        They carry no mass yet: the plan and what it gives to the other nodes stay as they are.
        """
        nodes, plan, settings = rough.nodes, rough.plan.plan, self.settings
        if not (np.bincount(rough.edges.ravel()) > 2).any():
            return Joint(rough)
        top, shares = top_shares(plan.indptr, plan.indices, plan.data, 6)
        triangles = filled_triangles(top, shares, settings.least_share, settings.common_points)
        touching = contacts(surface.graph, top[:, 0], len(nodes))
        opposite = triangles[:, [[1, 2], [0, 2], [0, 1]]].reshape(-1, 2)
        firm = relative_contact(touching, opposite).reshape(-1, 3) >= settings.contact
        found = parted(len(nodes), rough.edges, triangles, firm, nodes.fixed)
        if not len(found.beside):
            return Joint(rough)
        seen_from = None if thickness is None else thickness.centre
        places = cloud.positions if seen_from is None else seen_from
        return Joint(_with(rough, found, meeting_places(plan, cloud.mass, places, found)))


def _with(rough: RoughSkeleton, found: Parted, places: NDArray[np.float64]) -> RoughSkeleton:
    """Return the skeleton with new nodes at `places`, as thick as those that they stand beside."""
    nodes, beside = rough.nodes, found.beside
    new = len(beside)
    more = replace(
        nodes,
        positions=np.concatenate([nodes.positions, places]),
        mass=np.concatenate([nodes.mass, np.zeros(new)]),
        potentials=np.concatenate([nodes.potentials, nodes.potentials[beside]]),
        ids=np.concatenate([nodes.ids, nodes.ids.max() + 1 + np.arange(new)]),
        settled=np.concatenate([nodes.settled, np.ones(new, dtype=np.bool_)]),
        scale=np.concatenate([nodes.scale, nodes.scale[beside]]),
        fixed=np.concatenate([nodes.fixed, np.zeros(new, dtype=np.bool_)]),
        beyond=np.concatenate([nodes.beyond, np.full(new, -1)]),
    )
    plan = rough.plan.plan
    wider = sparse.csr_array((plan.data, plan.indices, plan.indptr), (plan.shape[0], len(more)))
    served = replace(rough.plan, nodes=more, plan=wider)
    skeletal = np.concatenate([rough.skeletal, np.ones(new, dtype=np.bool_)])
    return RoughSkeleton(served, found.edges, skeletal)
