"""Local scale of the shape."""

from __future__ import annotations

from typing import NamedTuple

from pydantic import Field

from mdcs_pipeline.kernels.thickness import local_radius
from mdcs_pipeline.messages import Known, MassCloud, Surface, Thickness
from mdcs_pipeline.stage import Settings, Stage


class ThicknessSettings(Settings):
    """Settings of `LocalThickness`."""

    landmarks: int = Field(
        1000,
        ge=8,
        le=100_000,
        description="Points at which patches are grown, spread evenly, at least.",
    )
    share: int = Field(
        16,
        ge=1,
        description="Most points that such a point stands for: a large scene is measured as well "
        "as an object of its own.",
    )
    closed: float = Field(
        0.06,
        gt=0.051,
        lt=0.25,
        description="γ: a patch of geodesic radius s has closed when its middle variance is at "
        "most γ s². A sheet has 0.25, a tube that just closes 0.05.",
    )
    slope: float = Field(
        0.15, gt=0, le=2, description="Most that the radius grows per unit of geodesic distance."
    )
    seed: int = Field(0, ge=0, description="Chooses the first landmark.")


class ThicknessOutput(NamedTuple):
    """Output of `LocalThickness`."""

    thickness: Thickness


class LocalThickness(Stage[ThicknessSettings]):
    """Measure half the local width of the shape at every point."""

    Settings = ThicknessSettings

    def __call__(
        self, cloud: MassCloud, surface: Surface, known: Known | None = None
    ) -> ThicknessOutput:
        """Return r_j in unit lengths with its confidence.

        What is known is not measured again; fewer landmarks do then.
        """
        settings = self.settings
        found = local_radius(
            surface.positions,
            cloud.mass,
            surface.graph,
            max(settings.landmarks, len(cloud) // settings.share),
            settings.closed,
            settings.slope,
            settings.seed,
            None if known is None else (known.asked, known.radius),
        )
        return ThicknessOutput(Thickness(found.radius, found.confidence, found.centre))
