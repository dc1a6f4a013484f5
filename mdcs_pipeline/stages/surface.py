"""Neighbourhood on the shape."""

from __future__ import annotations

from typing import NamedTuple

from pydantic import Field

from mdcs_pipeline.kernels.surface import NEIGHBOURS, UPRIGHT, surface_graph
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

    upright: float = Field(
        UPRIGHT,
        ge=0,
        lt=90,
        description="Least angle of a link with the normals at both its ends, in degrees: more "
        "upright ones cross a gap between two walls. 0 takes all.",
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
            cloud.positions, settings.neighbours, settings.averaging, settings.upright
        )
        return SurfaceOutput(Surface(found.positions, found.graph))
