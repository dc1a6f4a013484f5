"""Neighbourhood on the shape."""

from __future__ import annotations

from typing import NamedTuple

from pydantic import Field

from mdcs_pipeline.kernels.surface import NEIGHBOURS, STEEPEST, surface_graph
from mdcs_pipeline.messages import MassCloud, Surface
from mdcs_pipeline.stage import Settings, Stage


class SurfaceSettings(Settings):
    """Settings of `SurfaceGraph`."""

    neighbours: int = Field(
        NEIGHBOURS, ge=3, le=60, description="Nearest points that each point is linked to."
    )
    averaging: int = Field(
        0,
        ge=0,
        le=100,
        description="Nearest points that each point is averaged with first; 0 for none, which "
        "keeps close limbs apart.",
    )

    steepest: float = Field(
        STEEPEST,
        gt=0,
        le=1,
        description="Largest |cosine| of a link with the normals at both its ends: steeper ones "
        "cross a gap between two walls. 1 takes all.",
    )


class SurfaceOutput(NamedTuple):
    """Output of `SurfaceGraph`."""

    surface: Surface


class SurfaceGraph(Stage[SurfaceSettings]):
    """Link each point to its neighbours, after averaging some of the noise away."""

    Settings = SurfaceSettings

    def __call__(self, cloud: MassCloud) -> SurfaceOutput:
        """Return the neighbour graph of the cloud, in its unit frame."""
        settings = self.settings
        found = surface_graph(
            cloud.positions, settings.neighbours, settings.averaging, settings.steepest
        )
        return SurfaceOutput(Surface(found.positions, found.graph))
