"""The map in front of a streaming pipeline: frames in, the region to update out."""

from __future__ import annotations

import sys
from typing import Literal, NamedTuple

from pydantic import Field, model_validator

from mdcs_pipeline.errors import InputError
from mdcs_pipeline.messages import MassCloud, Nodes, PointCloud
from mdcs_pipeline.scene.choose import RegionRule, choose_region
from mdcs_pipeline.scene.integrate import FrameRule, add_frame, refusal
from mdcs_pipeline.scene.region import Region, empty_region, region_cloud, region_nodes
from mdcs_pipeline.scene.state import Scene
from mdcs_pipeline.stage import Settings, Stage

_REGION = RegionRule()
_FRAME = FrameRule()
# Fewer points than this have no surface to speak of.
_LEAST_POINTS = 24


class SceneSettings(Settings):
    """Settings of `SceneMap`."""

    voxel: float = Field(
        _FRAME.voxel,
        gt=0,
        le=0.5,
        description="Edge of a voxel in unit lengths; the unit of a scene is its first frame's "
        "size (about the diagonal of its cloud) and stays.",
    )
    voxel_size: float | None = Field(
        None,
        gt=0,
        description="Edge of a voxel in input units; given, it fixes the unit of all scenes, so "
        "that `voxel` units are this long.",
    )
    mode: Literal["accumulate", "window", "replace"] = Field(
        _FRAME.mode,
        description="accumulate: all frames add up; window: what was not seen within the last "
        "`window_frames` or `window_seconds` is forgotten; replace: each frame stands for the "
        "whole of a scene that moves.",
    )
    window_frames: int | None = Field(None, ge=1, description="Length of the window in frames.")
    window_seconds: float | None = Field(
        None, gt=0, description="Length of the window by the frames' stamps."
    )
    least_hits: int = Field(
        _FRAME.least_hits,
        ge=1,
        description="Points from which a voxel counts as surface; one is enough in a scene's "
        "first frame if most of its points are in voxels with fewer.",
    )
    patience: int = Field(
        _FRAME.patience,
        ge=1,
        description="Frames within which they must come: what noise hits now and then over a "
        "long time is no surface.",
    )
    shift: float = Field(
        _FRAME.shift,
        gt=0,
        le=1,
        description="Distance, in voxels, from which the moved centroid of one is a change.",
    )
    older: Literal["drop", "refuse"] = Field(
        "drop",
        description="What becomes of a frame whose stamp is not later than the last one's: it "
        "is dropped and counted, or it is an error. The scene stays as it is either way.",
    )
    share: float = Field(
        _REGION.share,
        gt=0,
        le=1,
        description="Changed share of a node's voxels from which it is updated.",
    )
    speck: int = Field(
        _REGION.speck,
        ge=1,
        description="Fewer new voxels than this that hang together, away from all that is known, "
        "wait for more.",
    )
    reach: float = Field(
        _REGION.reach, gt=0, description="New surface wakes the nodes within this many radii."
    )
    most: int = Field(
        _REGION.most,
        ge=100,
        description="Voxels that one frame updates, about; the rest waits for the next. Bounds "
        "the time of a frame.",
    )
    renewal: float = Field(
        _REGION.renewal,
        gt=1,
        description="A node is sought afresh, from new seeds beside it, once new surface has "
        "made its voxels this many times as many as they were then.",
    )

    @model_validator(mode="after")
    def _window_has_length(self) -> SceneSettings:
        if self.mode == "window" and self.window_frames is None and self.window_seconds is None:
            raise ValueError("a window needs window_frames or window_seconds")
        return self


class SceneOutput(NamedTuple):
    """Outputs of `SceneMap`: what to update, and none of it where nothing has changed."""

    region: Region
    cloud: MassCloud | None
    nodes: Nodes | None


class SceneMap(Stage[SceneSettings]):
    """Add a frame to the scene and name the region that it changes."""

    Settings = SceneSettings
    State = Scene

    def __call__(self, cloud: PointCloud, state: Scene) -> SceneOutput:
        """Return the active region with the nodes in and around it.

        An empty cloud adds nothing; what waits may still be worked on.

        Raises
        ------
        InputError
            If the frame is older than the last and that is refused, or it lies beyond the map.
        """
        settings, header = self.settings, cloud.header
        why = refusal(state, header)
        if why is not None and len(cloud):
            if settings.older == "refuse":
                raise InputError(
                    why,
                    received=f"{header.stamp_ns} ns after {state.stamp_ns} ns",
                    remedy="send frames in the order of their stamps, or set scene.older to drop",
                )
            return SceneOutput(empty_region(header, {"dropped": why}), None, None)
        if len(cloud):
            values = settings.model_dump(include=set(FrameRule._fields))
            add_frame(state, cloud, FrameRule(**values))
        rule = RegionRule(**settings.model_dump(include=set(RegionRule._fields)))
        drain = state.drain
        if settings.mode == "replace":
            # All of the scene at once: in parts, it would be made up of different moments.
            drain, rule = True, rule._replace(most=sys.maxsize)
        region = choose_region(state, rule, header, drain)
        if state.world is None or len(region) < _LEAST_POINTS:
            return SceneOutput(region, None, None)
        nodes = region_nodes(state.world, region)
        cloud_here = region_cloud(state.world, region)
        return SceneOutput(region, cloud_here, nodes if len(nodes) else None)
