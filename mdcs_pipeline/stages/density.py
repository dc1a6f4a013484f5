"""Mass from sampling density."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from mdcs_pipeline.errors import InputError
from mdcs_pipeline.ingest import given_cloud
from mdcs_pipeline.kernels.density import area_mass, neighbour_radius
from mdcs_pipeline.messages import MassCloud, PointCloud
from mdcs_pipeline.stage import Settings, Stage
from mdcs_pipeline.stages.downsample import unit_frame

LEAST_POINTS = 4


class DensitySettings(Settings):
    """Settings of `Density`."""

    neighbours: int = Field(
        8, ge=1, le=200, description="k of the neighbour radius r_j (section V)."
    )
    cap: float = Field(
        3.0,
        gt=1,
        description="Largest r_j, in medians over the cloud: without it an outlier would be "
        "given the largest mass of all.",
    )
    mass: Literal["area", "count"] = Field(
        "area",
        description="area: mass ∝ r_j², the surface that a point stands for (section V); "
        "count: mass ∝ the number of measured points.",
    )


class MassOutput(NamedTuple):
    """Output of `Density`."""

    cloud: MassCloud


class Density(Stage[DensitySettings]):
    """Give each point its mass and the cloud its unit frame (sections IV.A and V)."""

    Settings = DensitySettings

    def __call__(self, cloud: PointCloud) -> MassOutput:
        """Return the measure ν in the unit frame.

        Raises
        ------
        InputError
            If the cloud has too few points, or they all coincide.
        """
        cloud = given_cloud(cloud)
        unit = unit_frame(cloud)
        if len(cloud) < LEAST_POINTS:
            raise InputError(
                f"a skeleton needs at least {LEAST_POINTS} points",
                received=f"{len(cloud)} points after downsampling and cleaning",
                remedy="add points, or take a smaller voxel",
            )
        positions = unit.to_unit(cloud.positions)
        if self.settings.mass == "area":
            radius = neighbour_radius(positions, self.settings.neighbours)
            mass = area_mass(radius, self.settings.cap)
        else:
            weights = np.ones(len(cloud)) if cloud.weights is None else cloud.weights
            mass = weights / weights.sum()
        return MassOutput(MassCloud(positions, mass, unit, cloud.header))
