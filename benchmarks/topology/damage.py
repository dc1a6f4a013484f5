"""Damage done to a clean sample of a shape, one function a kind, every level by name.

Lengths are in units of each point's own tube radius, so that thin limbs suffer as thick ones do.
Damage never erases a limb: where a hole or a view would leave less than `LEAST_LEFT` of a branch,
another place is drawn, since no method could know of a limb that left no trace.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.topology.solid import Floats, Sample, Shape, join, sample
from benchmarks.topology.views import depth_views

LEAST_LEFT = 0.35
POINTS = 6000
Apply = Callable[[Shape, int, np.random.Generator], Sample]


@dataclass(frozen=True)
class Damage:
    """A kind of damage at one level: `name` is ``kind-level``."""

    name: str
    apply: Apply

    @property
    def kind(self) -> str:
        """The name without its level."""
        return self.name.split("-")[0]


def clean(shape: Shape, n: int, rng: np.random.Generator) -> Sample:
    """Uniform by area, on the surface."""
    return sample(shape, n, rng)


def noise(shape: Shape, n: int, rng: np.random.Generator, *, level: float) -> Sample:
    """Isotropic Gaussian noise, sigma = `level` x the point's own tube radius."""
    cloud = sample(shape, n, rng)
    return cloud.moved(cloud.points + level * cloud.radius[:, None] * rng.normal(size=(n, 3)))


def loss(shape: Shape, n: int, rng: np.random.Generator, *, share: float) -> Sample:
    """A random `share` of the points is missing."""
    cloud = sample(shape, n, rng)
    return cloud.take(rng.permutation(n)[: round(n * (1 - share))])


def least_left(shape: Shape, before: Sample, kept: NDArray[np.bool_]) -> float:
    """Share of its points that the worst hit branch keeps."""
    branch = shape.branches[before.edge]
    size = int(shape.branches.max()) + 1
    had = np.bincount(branch, minlength=size)
    has = np.bincount(branch[kept], minlength=size)
    return float((has[had > 0] / had[had > 0]).min())


def holes(
    shape: Shape, n: int, rng: np.random.Generator, *, level: float, count: int = 3
) -> Sample:
    """`count` empty balls around surface points, of `level` local radii each.

    A ball that takes more than 15 % of the points or leaves a branch too little is drawn again,
    up to 60 times, then made a tenth smaller: the whole of an egg lies within 2.5 radii.
    """
    cloud = sample(shape, n, rng)
    kept = np.ones(n, dtype=bool)
    for _ in range(count):
        size, tries = level, 0
        while True:
            center = rng.integers(n)
            away = np.linalg.norm(cloud.points - cloud.points[center], axis=1)
            trial = kept & (away > size * cloud.radius[center])
            few = np.count_nonzero(kept) - np.count_nonzero(trial) <= 0.15 * n
            if few and least_left(shape, cloud, trial) >= LEAST_LEFT:
                kept = trial
                break
            tries += 1
            if tries % 60 == 0:
                size *= 0.9
    return cloud.take(kept)


def outliers(shape: Shape, n: int, rng: np.random.Generator, *, share: float) -> Sample:
    """`share` x n points, uniform in the bounding box enlarged by 10 %, join the cloud."""
    cloud = sample(shape, n, rng)
    low, high = cloud.points.min(axis=0), cloud.points.max(axis=0)
    margin = 0.05 * (high - low)
    extra = round(share * n)
    points = rng.uniform(low - margin, high + margin, size=(extra, 3))
    blank = np.zeros((extra, 3))
    return join([cloud, Sample(points, blank, np.full(extra, np.nan), np.full(extra, -1))])


def density(
    shape: Shape, n: int, rng: np.random.Generator, *, ratio: float, smooth: bool = True
) -> Sample:
    """Density falls by `ratio` along the longest axis: smoothly, or at once half way.

    Which end is the dense one is drawn.
    """
    low, high = shape.box
    axis = int(np.argmax(high - low))
    flip = rng.random() < 0.5
    parts: list[Sample] = []
    while sum(map(len, parts)) < n:
        pool = sample(shape, 2 * n, rng)
        place = (pool.points[:, axis] - low[axis]) / (high - low)[axis]
        place = 1 - place if flip else place
        weight = ratio ** (-place) if smooth else np.where(place < 0.5, 1.0, 1.0 / ratio)
        parts.append(pool.take(rng.random(len(pool)) < weight))
    return join(parts).take(np.arange(n))


def views(
    shape: Shape, n: int, rng: np.random.Generator, *, count: int, misaligned: float = 0.0
) -> Sample:
    """Depth images from `count` cameras around the shape, `n` points in all.

    `misaligned` shifts each view by that many median tube radii, and turns it so that its far
    ends move as much again.
    """
    seen = depth_views(shape, n, rng, count, partial(least_left, shape), LEAST_LEFT)
    if misaligned:
        seen = [_displaced(shape, view, misaligned, rng) for view in seen]
    return join(seen)


def _displaced(shape: Shape, view: Sample, level: float, rng: np.random.Generator) -> Sample:
    reach = level * float(np.median(view.radius))
    shift, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    center = view.points.mean(axis=0)
    offset = view.points - center
    turn = reach / (0.5 * shape.diagonal)
    turned: Floats = (
        offset * np.cos(turn)
        + np.cross(axis, offset) * np.sin(turn)
        + np.outer(offset @ axis, axis) * (1 - np.cos(turn))
    )
    return view.moved(center + turned + reach * shift)


DAMAGES: dict[str, Damage] = {
    damage.name: damage
    for damage in (
        Damage("clean", clean),
        *(Damage(f"noise-{v}", partial(noise, level=v)) for v in (0.15, 0.3, 0.5)),
        *(Damage(f"loss-{v}", partial(loss, share=v / 100)) for v in (50, 80)),
        *(Damage(f"holes-{v}", partial(holes, level=v)) for v in (1.5, 2.5)),
        *(Damage(f"outliers-{v}", partial(outliers, share=v / 100)) for v in (2, 5)),
        Damage("density-7-smooth", partial(density, ratio=7.0)),
        Damage("density-7-halves", partial(density, ratio=7.0, smooth=False)),
        *(Damage(f"views-{v}", partial(views, count=v)) for v in (2, 3)),
        *(Damage(f"misaligned-{v}", partial(views, count=v, misaligned=0.2)) for v in (2, 3)),
    )
}
# Fig. 13 of the paper: only the ratio changes.
FIG13: dict[str, Damage] = {
    f"fig13-{v}": Damage(f"fig13-{v}", partial(density, ratio=float(v))) for v in (3, 5, 7)
}
