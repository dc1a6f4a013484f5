"""Several clouds into one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mdcs_pipeline.errors import InputError
from mdcs_pipeline.ingest import given_cloud
from mdcs_pipeline.messages import PointCloud
from mdcs_pipeline.stage import Settings, Stage


class CombineSettings(Settings):
    """The stage has no settings."""


class Combined(NamedTuple):
    """Output of `Combine`."""

    cloud: PointCloud


class Combine(Stage[CombineSettings]):
    """Join clouds of one frame, as from several sensors, into one cloud."""

    Settings = CombineSettings

    def __call__(self, clouds: tuple[PointCloud, ...]) -> Combined:
        """Return all points in the order of the clouds, with the newest cloud's header.

        Raises
        ------
        InputError
            If the clouds are in different frames.
        """
        clouds = tuple(given_cloud(cloud) for cloud in clouds)
        frames = {cloud.header.frame_id for cloud in clouds}
        if len(frames) > 1:
            raise InputError(
                "the clouds to combine are in different frames",
                received=", ".join(sorted(frames)),
                remedy="transform them into one frame first",
            )
        weights = None
        if any(cloud.weights is not None for cloud in clouds):
            weights = np.concatenate(
                [np.ones(len(c)) if c.weights is None else c.weights for c in clouds]
            )
        return Combined(
            PointCloud(
                np.concatenate([cloud.positions for cloud in clouds]),
                weights,
                max((cloud.header for cloud in clouds), key=lambda header: header.stamp_ns),
                sum(cloud.dropped for cloud in clouds),
            )
        )
