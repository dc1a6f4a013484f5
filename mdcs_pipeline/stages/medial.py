"""Where the middle of the limb is, seen from each point of its surface."""

from __future__ import annotations

from typing import NamedTuple

from pydantic import Field, model_validator

from mdcs_pipeline.kernels.medial import Medial as Balls
from mdcs_pipeline.kernels.medial import MedialRule, Remembered, medial_places, without_gaps
from mdcs_pipeline.messages import Known, MassCloud, Surface, Thickness
from mdcs_pipeline.stage import Settings, Stage

_RULE = MedialRule()


class MedialSettings(Settings):
    """Settings of `Medial`."""

    coarse: float = Field(
        _RULE.coarse,
        ge=0,
        le=0.5,
        description="Points this near to another, in local radii, have its ball: what is thick "
        "against its sampling costs no more than what is thin.",
    )
    patch: float = Field(
        _RULE.patch,
        gt=0,
        le=2,
        description="Radius of the patch that a normal is fitted to, in local radii.",
    )
    apart: float = Field(
        _RULE.apart,
        gt=0,
        le=3.1,
        description="Angle in radians, seen from the centre of a ball that touches the surface, "
        "from which other points limit it: what is nearer shows noise.",
    )
    pierced: int = Field(
        _RULE.pierced, ge=0, le=100, description="Points that may lie inside such a ball."
    )
    widest: float = Field(
        _RULE.widest, gt=1, description="Largest ball, in the radius of the patch that closed."
    )
    rough: float = Field(
        _RULE.rough,
        ge=0,
        description="Roughness, spread of a patch along its normal in local radii, from which "
        "the patch is fitted again.",
    )
    passes: int = Field(
        _RULE.passes,
        ge=1,
        le=10,
        description="How often patches are fitted, each time to the points as smoothed before.",
    )
    sure: float = Field(
        _RULE.sure,
        ge=0,
        description="How far neighbours' medial places lie from a line, in their radius, up to "
        "which they are believed.",
    )
    unsure: float = Field(
        _RULE.unsure,
        gt=0,
        description="The same, from which they are not: there points stay where they are.",
    )
    gap: float = Field(
        0.5,
        gt=0,
        description="How much farther apart than two neighbours their medial places may be, in "
        "the smaller radius, before the link between them leads through the air.",
    )

    @model_validator(mode="after")
    def _belief_fades(self) -> MedialSettings:
        if self.unsure <= self.sure:
            raise ValueError("unsure must be larger than sure")
        return self


class MedialOutput(NamedTuple):
    """Outputs of `Medial`."""

    thickness: Thickness
    surface: Surface


class Medial(Stage[MedialSettings]):
    """Find, from each point, the centre and radius of the ball inside that touches it."""

    Settings = MedialSettings

    def __call__(
        self,
        cloud: MassCloud,
        surface: Surface,
        thickness: Thickness,
        known: Known | None = None,
    ) -> MedialOutput:
        """Return the thickness with the balls' radii and centres, where the surface shows them.

        The surface comes without the links between limbs that these tell apart. What is known
        stays as it is, and tells its neighbours.
        """
        rule, before = self.settings.model_dump(), _remembered(known)
        gap = rule.pop("gap")
        found = medial_places(
            cloud.positions,
            cloud.mass,
            surface.graph,
            thickness.radius,
            MedialRule(**rule),
            before,
        )
        graph = without_gaps(surface.graph, cloud.positions, found, gap, before)
        return MedialOutput(
            Thickness(found.radius, thickness.confidence, found.places, found.trust, found.normals),
            Surface(surface.positions, graph),
        )


def _remembered(known: Known | None) -> Remembered | None:
    if known is None:
        return None
    balls = Balls(known.middle, known.radius, known.trust, known.normal)
    return Remembered(known.asked, balls)
