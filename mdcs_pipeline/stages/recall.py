"""What was measured before, and what has to be measured again."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mdcs_pipeline.kernels.compiled.grid import grid_of, share_near
from mdcs_pipeline.messages import Known, MassCloud
from mdcs_pipeline.scene.region import Region
from mdcs_pipeline.stage import Settings, Stage

FloatArray = NDArray[np.float64]


class RecallSettings(Settings):
    """Settings of `Recall`."""

    around: float = Field(
        1.3,
        gt=1,
        description="Radii around its medial place that a point is measured by: all of its limb "
        "there, and a little more.",
    )
    sure: float = Field(
        1.0,
        ge=0,
        le=1,
        description="Trust in its medial place below which a point is measured again. It fades "
        "with the share of the surface around that is new: 1 asks wherever any is. Less is "
        "cheaper and older.",
    )


class Recalled(NamedTuple):
    """Output of `Recall`."""

    known: Known


class Recall(Stage[RecallSettings]):
    """Name the points that have to be measured, and give back what is known of the others."""

    Settings = RecallSettings

    def __call__(self, cloud: MassCloud, region: Region) -> Recalled:
        """Return what is known of the region's points.

        A patch that runs into the region's rim was cut off there: around what is updated the
        value from when its surroundings were whole is the better one.
        """
        trust = region.trust * (1.0 - self._renewed(cloud, region))
        asked = region.taken & (region.changed | (trust < self.settings.sure))
        asked |= region.radius <= 0
        middle = np.where(asked[:, None], cloud.positions, region.middle)
        return Recalled(Known(asked, region.radius, middle, trust, region.normal))

    def _renewed(self, cloud: MassCloud, region: Region) -> FloatArray:
        """Return the share of what each known point was measured by that is new."""
        renewed = np.zeros(len(region))
        which = np.flatnonzero(region.taken & ~region.changed & (region.radius > 0))
        if len(which) and region.changed.any():
            reach = self.settings.around * region.radius[which]
            grid = grid_of(cloud.positions, float(np.median(reach)))
            new = region.changed[grid.order]
            renewed[which] = share_near(grid, new, region.middle[which], reach)
        return renewed
