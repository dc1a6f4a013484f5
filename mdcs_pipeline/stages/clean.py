"""Outliers out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pydantic import Field

from mdcs_pipeline.ingest import given_cloud
from mdcs_pipeline.kernels.nearest import nearest
from mdcs_pipeline.kernels.outliers import lonely_points
from mdcs_pipeline.kernels.surface import islands
from mdcs_pipeline.messages import PointCloud
from mdcs_pipeline.stage import Settings, Stage


class CleanSettings(Settings):
    """Settings of `Clean`."""

    neighbours: int = Field(
        8, ge=1, le=100, description="Neighbour that a point's radius reaches to."
    )
    near: float = Field(
        1.8, gt=1, description="Radius of a point, in its neighbours' median, from which it goes."
    )
    sparse: float = Field(
        4.0,
        gt=1,
        description="Radius of a point, in medians over the cloud, from which it goes if its "
        "neighbours fill space instead of a surface. Below `far` it also takes sparse thin limbs.",
    )
    far: float = Field(
        4.0, gt=1, description="Radius of a point, in medians, from which it goes in any case."
    )
    round_from: float = Field(
        0.1,
        gt=0,
        lt=1,
        description="λ1/λ3 of the neighbours from which they fill space; about 0.25 in a volume.",
    )
    passes: int = Field(
        3, ge=0, le=10, description="Times that the test is run: outliers hide each other."
    )
    least_island: float = Field(
        0.004,
        ge=0,
        lt=1,
        description="Smaller shares of the points that hang together with no other are dropped.",
    )


class Cleaned(NamedTuple):
    """Output of `Clean`."""

    cloud: PointCloud


class Clean(Stage[CleanSettings]):
    """Drop points that lie far from all others, and specks of them."""

    Settings = CleanSettings

    def __call__(self, cloud: PointCloud) -> Cleaned:
        """Return the cloud without its outliers; a cloud of a few points stays as it is."""
        cloud = given_cloud(cloud)
        keep = np.arange(len(cloud))
        positions = np.asarray(cloud.positions, dtype=np.float64)
        settings = self.settings
        found = None
        for _ in range(settings.passes):
            if len(keep) <= 4 * settings.neighbours:
                break
            found = nearest(positions[keep], settings.neighbours)
            lonely = lonely_points(
                positions[keep],
                found,
                settings.near,
                settings.sparse,
                settings.far,
                settings.round_from,
            )
            if not lonely.any():
                break
            keep, found = keep[~lonely], None
        if settings.least_island > 0 and len(keep) > 4 * settings.neighbours:
            if found is None:
                found = nearest(positions[keep], settings.neighbours)
            keep = keep[~islands(found.indices, np.ones(len(keep)), settings.least_island)]
        weights = None if cloud.weights is None else cloud.weights[keep]
        return Cleaned(PointCloud(cloud.positions[keep], weights, cloud.header, cloud.dropped))
