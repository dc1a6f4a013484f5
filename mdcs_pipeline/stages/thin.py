"""Fewer points on what is thick."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pydantic import Field

from mdcs_pipeline.ingest import given_cloud
from mdcs_pipeline.kernels.thinning import flat_groups, merged
from mdcs_pipeline.messages import PointCloud
from mdcs_pipeline.stage import Settings, Stage
from mdcs_pipeline.stages.downsample import unit_frame, voxel_edge


class ThinSettings(Settings):
    """Settings of `Thin`."""

    voxel: float = Field(
        0.016,
        gt=0,
        le=0.5,
        description="Edge of a voxel in unit lengths (about the diagonal of the cloud) whose "
        "points are joined where the surface is flat: twice that of `downsample` by default.",
    )
    voxel_size: float | None = Field(
        None, gt=0, description="Edge of a voxel in input units; replaces `voxel` when given."
    )
    flat: float = Field(
        1.2,
        gt=0,
        description="Radius in which the surface bends, in `voxel`, from which it counts as flat.",
    )
    enough: int = Field(
        6000,
        ge=0,
        description="Points that are left at least, the flattest places being thinned first; "
        "clouds of no more stay as they are.",
    )


class Thinned(NamedTuple):
    """Output of `Thin`."""

    cloud: PointCloud


class Thin(Stage[ThinSettings]):
    """Join points where the surface is flat against their spacing; thin limbs keep theirs."""

    Settings = ThinSettings

    def __call__(self, cloud: PointCloud) -> Thinned:
        """Return the cloud with fewer points; weights keep their total.

        Raises
        ------
        InputError
            If all points coincide.
        """
        cloud = given_cloud(cloud)
        settings = self.settings
        if len(cloud) <= settings.enough:
            return Thinned(cloud)
        unit = unit_frame(cloud)
        size = voxel_edge(settings.voxel, settings.voxel_size, unit)
        places = unit.to_unit(cloud.positions)
        group = flat_groups(places, size, settings.flat, settings.enough)
        weights = np.ones(len(cloud)) if cloud.weights is None else cloud.weights
        found = merged(np.asarray(cloud.positions, dtype=np.float64), weights, group)
        return Thinned(PointCloud(found.centroids, found.weights, cloud.header, cloud.dropped))
