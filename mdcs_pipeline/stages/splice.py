"""An updated region back into its scene."""

from __future__ import annotations

from typing import NamedTuple

from mdcs_pipeline.messages import RoughSkeleton, Skeleton, Surface, Thickness
from mdcs_pipeline.scene.change import SceneChange
from mdcs_pipeline.scene.region import Region
from mdcs_pipeline.scene.splice import Update, splice_nothing, splice_update
from mdcs_pipeline.scene.state import Scene
from mdcs_pipeline.stage import Settings, Stage


class SpliceSettings(Settings):
    """The stage has no settings."""


class Spliced(NamedTuple):
    """Output of `Splice`."""

    changes: SceneChange


class Splice(Stage[SpliceSettings]):
    """Write what was found for a region into the scene, and say what changed."""

    Settings = SpliceSettings
    State = Scene

    def __call__(
        self,
        region: Region,
        state: Scene,
        rough: RoughSkeleton | None = None,
        skeleton: Skeleton | None = None,
        surface: Surface | None = None,
        thickness: Thickness | None = None,
    ) -> Spliced:
        """Return the change; without a skeleton there is none, and what waits goes on waiting."""
        if rough is None or skeleton is None or surface is None or thickness is None:
            return Spliced(splice_nothing(state, region))
        update = Update(rough, skeleton, surface, thickness)
        return Spliced(splice_update(state, region, update))
