"""New nodes where new surface has appeared."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mdcs_pipeline.arrays import BoolArray, IntArray
from mdcs_pipeline.kernels.compiled.cheapest import cheapest_site
from mdcs_pipeline.kernels.fallen import fallen_apart
from mdcs_pipeline.kernels.seeding import spread_points
from mdcs_pipeline.messages import MassCloud, Nodes, Surface, Thickness
from mdcs_pipeline.scene.region import Region
from mdcs_pipeline.stage import Settings, Stage


class NewbornSettings(Settings):
    """Settings of `Newborn`."""

    cover: float = Field(
        1.4,
        gt=0,
        description="A point is new surface without a node when its cost to all of them exceeds "
        "the square of this: its distance in local radii.",
    )
    forsaken: float = Field(
        2.5,
        gt=0,
        description="The same for a point that a node owns: no node stands where its limb is.",
    )
    spacing: float = Field(0.4, ge=0, le=2, description="Spacing of new nodes in local radii.")
    ratio: float = Field(0.1, gt=0, le=1, description="Most new nodes per point without one.")
    apart: float = Field(
        0.25,
        gt=0,
        le=1,
        description="Share of a node's points from which a piece that hangs together with no "
        "other of them is given nodes of its own.",
    )
    potentials: Literal["even", "lowered"] = Field(
        "even",
        description="even: a new node is born at the potential of its nearest; lowered: by that "
        "one's mean cost below it, as suits prescribed masses: it then takes about as much.",
    )
    seed: int = Field(0, ge=0, description="Chooses the first new node.")


class NewbornOutput(NamedTuple):
    """Output of `Newborn`."""

    nodes: Nodes


class Newborn(Stage[NewbornSettings]):
    """Add nodes where none stands for the surface, and take out those that stand for none."""

    Settings = NewbornSettings

    def __call__(
        self,
        cloud: MassCloud,
        region: Region,
        surface: Surface,
        thickness: Thickness,
        nodes: Nodes | None = None,
    ) -> NewbornOutput:
        """Return the scene's nodes of the region with the new ones behind them.

        Known nodes take the scale of the points that they own; fixed ones keep theirs.
        """
        if nodes is None:
            nodes = Nodes(np.empty((0, 3)), np.empty(0), header=cloud.header)
        known = _picked(nodes, np.flatnonzero(self._served(cloud, nodes, region, thickness)))
        owner = _rows_of(region.owner, known.ids)
        known = _rescaled(known, owner, thickness.radius)
        bare = self._bare(cloud, known, region, surface, thickness, owner)
        chosen = self._chosen(cloud, thickness, bare, at_least_one=not len(known))
        return NewbornOutput(self._with_new(cloud, known, region, thickness, owner, chosen))

    def _served(
        self, cloud: MassCloud, nodes: Nodes, region: Region, thickness: Thickness
    ) -> BoolArray:
        """Return the nodes that stay: the fixed, and those that own points or lie at new ones."""
        owner = _rows_of(region.owner, nodes.ids)
        own = np.bincount(owner[owner >= 0], minlength=len(nodes))
        fresh = np.flatnonzero(owner < 0)
        if len(nodes) and len(fresh):
            places, scale = cloud.positions[fresh], thickness.radius[fresh]
            nearest, cost = cheapest_site(places, scale, nodes.positions, nodes.scale)
            close = nearest[cost <= self.settings.cover**2]
            own += np.bincount(close, minlength=len(nodes))
        return np.asarray(nodes.fixed | (own > 0))

    def _bare(
        self,
        cloud: MassCloud,
        known: Nodes,
        region: Region,
        surface: Surface,
        thickness: Thickness,
        owner: IntArray,
    ) -> BoolArray:
        if not len(known):
            return np.asarray(region.taken)
        _, cost = cheapest_site(cloud.positions, thickness.radius, known.positions, known.scale)
        active = np.where(region.taken & (owner >= 0), owner, -1)
        apart = fallen_apart(surface.graph, active, self.settings.apart)
        grown = np.isin(region.owner, region.grown)
        # What a node owns it has come to stand for: seeded again, it would only be merged again.
        new = (region.owner < 0) & (cost > self.settings.cover**2)
        # Unless it lies far off: its limb was shed while it was short, and has grown since.
        new |= cost > self.settings.forsaken**2
        return np.asarray(region.taken & (new | apart | grown))

    def _chosen(
        self, cloud: MassCloud, thickness: Thickness, bare: BoolArray, at_least_one: bool
    ) -> IntArray:
        places = np.flatnonzero(bare)
        most = int(np.ceil(self.settings.ratio * len(places)))
        if at_least_one:
            most = max(most, 1)
        if not len(places) or not most:
            return np.empty(0, np.int64)
        found = spread_points(
            cloud.positions[places],
            most,
            self.settings.seed,
            thickness.radius[places],
            self.settings.spacing,
        )
        return places[found]

    def _with_new(
        self,
        cloud: MassCloud,
        known: Nodes,
        region: Region,
        thickness: Thickness,
        owner: IntArray,
        chosen: IntArray,
    ) -> Nodes:
        count = len(chosen)
        ids = region.next_id + np.arange(count)
        potentials = np.zeros(count)
        mean = 1.0 / max(len(known), 1)
        if len(known) and count:
            places, scale = cloud.positions[chosen], thickness.radius[chosen]
            nearest, _ = cheapest_site(places, scale, known.positions, known.scale)
            potentials = known.potentials[nearest]
            if self.settings.potentials == "lowered":
                potentials = potentials - _mean_cost(cloud, known, thickness, owner)[nearest]
        mass = np.concatenate([known.mass, np.full(count, mean)])
        return Nodes(
            positions=np.concatenate([known.positions, cloud.positions[chosen]]),
            mass=mass / mass.sum(),
            potentials=np.concatenate([known.potentials, potentials]),
            ids=np.concatenate([known.ids, ids]),
            links=known.links,
            settled=np.concatenate([known.settled, np.zeros(count, dtype=bool)]),
            scale=np.concatenate([known.scale, thickness.radius[chosen]]),
            fixed=np.concatenate([known.fixed, np.zeros(count, dtype=bool)]),
            beyond=np.concatenate([known.beyond, np.full(count, -1)]),
            header=known.header,
        )


def _rows_of(names: IntArray, ids: IntArray) -> IntArray:
    """Return the row of each name among `ids`, −1 where it is not there."""
    if not len(ids):
        return np.full(len(names), -1, np.int64)
    order = np.argsort(ids)
    at = np.minimum(np.searchsorted(ids[order], names), len(ids) - 1)
    return np.where(ids[order][at] == names, order[at], -1)


def _picked(nodes: Nodes, kept: IntArray) -> Nodes:
    row = np.full(len(nodes), -1, np.int64)
    row[kept] = np.arange(len(kept))
    links = row[nodes.links]
    mass = nodes.mass[kept]
    return Nodes(
        positions=nodes.positions[kept],
        mass=mass / mass.sum() if mass.sum() > 0 else np.full(len(kept), 1 / max(len(kept), 1)),
        potentials=nodes.potentials[kept],
        ids=nodes.ids[kept],
        links=links[(links >= 0).all(axis=1)],
        settled=nodes.settled[kept],
        scale=nodes.scale[kept],
        fixed=nodes.fixed[kept],
        beyond=nodes.beyond[kept],
        header=nodes.header,
    )


def _rescaled(nodes: Nodes, owner: IntArray, radius: NDArray[np.float64]) -> Nodes:
    owned = owner >= 0
    count = np.bincount(owner[owned], minlength=len(nodes))
    total = np.bincount(owner[owned], radius[owned], minlength=len(nodes))
    mean = total / np.maximum(count, 1)
    scale = np.where(nodes.fixed | (count == 0), nodes.scale, mean)
    return replace(nodes, scale=scale)


def _mean_cost(
    cloud: MassCloud, nodes: Nodes, thickness: Thickness, owner: IntArray
) -> NDArray[np.float64]:
    owned = np.flatnonzero(owner >= 0)
    mine = owner[owned]
    gap = cloud.positions[owned] - nodes.positions[mine]
    cost = np.square(gap).sum(axis=1) / (thickness.radius[owned] * nodes.scale[mine])
    count = np.bincount(mine, minlength=len(nodes))
    return np.bincount(mine, cost, minlength=len(nodes)) / np.maximum(count, 1)
