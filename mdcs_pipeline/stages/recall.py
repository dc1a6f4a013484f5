"""Thickness that was measured before stays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mdcs_pipeline.messages import Thickness
from mdcs_pipeline.scene.region import Region
from mdcs_pipeline.stage import Settings, Stage


class RecallSettings(Settings):
    """The stage has no settings."""


class Recalled(NamedTuple):
    """Output of `Recall`."""

    thickness: Thickness


class Recall(Stage[RecallSettings]):
    """Take the measured thickness where the scene has changed, and the known one around it."""

    Settings = RecallSettings

    def __call__(self, region: Region, thickness: Thickness) -> Recalled:
        """Return the thickness of the region's points.

        A patch that runs into the region's rim was cut off there: around what is updated the
        value from when its surroundings were whole is the better one. What a check widened is
        measured again: a loop may be false only for as long as half of a shape is seen.
        """
        known = (region.radius > 0) & ~region.taken
        radius = np.where(known, region.radius, thickness.radius)
        centre = thickness.centre
        if centre is not None:
            centre = np.where(known[:, None], region.middle, centre)
        return Recalled(Thickness(radius, thickness.confidence, centre))
