"""Where the middle of the limb is when noise hides its surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mdcs_pipeline.errors import InputError
from mdcs_pipeline.kernels.ridges import RidgeRule, levelled, ridges, surface_noise
from mdcs_pipeline.kernels.surface import NEIGHBOURS, UPRIGHT, surface_graph
from mdcs_pipeline.messages import MassCloud, Surface, Thickness
from mdcs_pipeline.stage import Settings, Stage

FloatArray = NDArray[np.float64]

_RULE = RidgeRule()
# Trust under which a medial place is not believed.
_BELIEVED = 0.5


class RidgeSettings(Settings):
    """Settings of `Ridge`."""

    unsure: float = Field(
        0.1,
        ge=0,
        le=1,
        description="Share of points without a medial place from which a cloud may be noisy; "
        "0 looks at every cloud.",
    )
    noise: float = Field(
        0.21,
        ge=0,
        description="Spread of the surface, in the local radius, from which the cloud is noisy: "
        "others stay as they are.",
    )
    closed: float = Field(
        _RULE.closed,
        gt=0,
        lt=1,
        description="Smallest variance of points as a window weighs them, in its own and as many "
        "points would have it, at which the window is as wide as its limb.",
    )
    coarse: float = Field(
        _RULE.coarse,
        ge=0,
        le=1,
        description="Points this near to another, in local radii, have its place.",
    )
    starts: float = Field(
        _RULE.starts,
        gt=0,
        le=2,
        description="Distance in local radii between the points where scales are sought.",
    )
    near: int = Field(
        _RULE.near, ge=1, le=1000, description="Scales that each point takes the median of."
    )
    slope: float = Field(
        _RULE.slope,
        gt=0,
        le=10,
        description="Most that the window grows per unit of distance along the surface.",
    )


class RidgeOutput(NamedTuple):
    """Outputs of `Ridge`."""

    thickness: Thickness
    surface: Surface


class Ridge(Stage[RidgeSettings]):
    """In a cloud that is noisy all over, carry mass from the ridges of its density."""

    Settings = RidgeSettings

    def __call__(self, cloud: MassCloud, surface: Surface, thickness: Thickness) -> RidgeOutput:
        """Return the thickness with ridges as centres, and the surface freed of noise.

        Both as they came where the surface shows well enough.

        Raises
        ------
        InputError
            If the thickness does not say how far its centres are believed.
        """
        if thickness.trust is None:
            raise InputError(
                "the thickness must come with the trust in its centres",
                remedy="take it from a stage 'medial'",
            )
        settings, as_before = self.settings, RidgeOutput(thickness, surface)
        unsure = thickness.trust < _BELIEVED
        if not len(cloud) or unsure.mean() < settings.unsure:
            return as_before
        rule = RidgeRule(**settings.model_dump(include=set(RidgeRule._fields)))
        measured = cloud.positions, cloud.mass, thickness.radius
        if surface_noise(*measured, rule) < settings.noise:
            return as_before
        found = ridges(*measured, surface.graph, rule)
        if found is None:
            return as_before
        level = levelled(cloud.positions, found)
        links = surface_graph(level, NEIGHBOURS, upright=UPRIGHT)
        return RidgeOutput(
            Thickness(
                found.radius,
                thickness.confidence,
                found.places,
                np.ones(len(cloud)),
                _outward(level - found.places, thickness.normal),
            ),
            Surface(level, links.graph),
        )


def _outward(away: FloatArray, other: FloatArray | None) -> FloatArray:
    """Return where points are from their ridge, of length 1; where they are on it, the other."""
    length = np.linalg.norm(away, axis=1, keepdims=True)
    if other is None:
        other = np.tile([1.0, 0.0, 0.0], (len(away), 1))
    return np.where(length > 0, away / np.where(length > 0, length, 1.0), other)
