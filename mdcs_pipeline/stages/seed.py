"""First candidates for skeleton nodes."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from mdcs_pipeline.kernels.seeding import random_points, spread_points
from mdcs_pipeline.messages import MassCloud, Nodes, Thickness
from mdcs_pipeline.stage import Settings, Stage


class SeedSettings(Settings):
    """Settings of `Seed`."""

    ratio: float = Field(0.1, gt=0, le=1, description="m/n, candidates per point (Table III).")
    least: int = Field(8, ge=1, description="Candidates that a small cloud gets at least.")
    choice: Literal["random", "spread"] = Field(
        "random",
        description="random: drawn evenly from the points (Algorithm 1); spread: each the point "
        "farthest from those before it, which hardly depends on the seed.",
    )
    spacing: float = Field(
        0.4,
        ge=0,
        le=2,
        description="With spread and a thickness: no more candidates once every point has one "
        "within this many local radii. Fewer than m/n are then enough where the shape is thick.",
    )
    place: Literal["surface", "centre"] = Field(
        "surface",
        description="surface: candidates start where their points are; centre: in the middle of "
        "the patch of surface that closes around their limb, where a thickness says so.",
    )
    seed: int = Field(0, ge=0, description="Seed of the random choice.")


class SeedOutput(NamedTuple):
    """Output of `Seed`."""

    nodes: Nodes


class Seed(Stage[SeedSettings]):
    """Choose candidates among the points, of equal mass (Algorithm 1, lines 2 and 3)."""

    Settings = SeedSettings

    def __call__(self, cloud: MassCloud, thickness: Thickness | None = None) -> SeedOutput:
        """Return the candidates; with a thickness they take the scale of their points."""
        settings = self.settings
        n = len(cloud)
        m = min(n, max(settings.least, round(settings.ratio * n)))
        if settings.choice == "spread":
            radius = None if thickness is None else thickness.radius
            least = 0.0 if thickness is None else settings.spacing
            chosen = spread_points(cloud.positions, m, settings.seed, radius, least)
        else:
            chosen = random_points(n, m, settings.seed)
        m = len(chosen)
        scale = np.ones(m) if thickness is None else thickness.radius[chosen]
        places = cloud.positions
        if settings.place == "centre" and thickness is not None and thickness.centre is not None:
            places = thickness.centre
        nodes = Nodes(places[chosen], np.full(m, 1.0 / m), scale=scale, header=cloud.header)
        return SeedOutput(nodes)
