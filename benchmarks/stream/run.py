"""Running streams and cold runs side by side."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.stream.scenes import Views
from benchmarks.topology.score import densify
from benchmarks.topology.solid import Floats, Truth
from mdcs_pipeline.hooks import Hook, StageEvent
from mdcs_pipeline.pipeline import Pipeline
from mdcs_pipeline.skeleton import Skeleton
from mdcs_pipeline.stream import Stream


class Entries(Hook):
    """Adds up the kernel entries that transport reads."""

    def __init__(self) -> None:
        self.count = 0

    def stage_finished(self, event: StageEvent) -> None:
        if event.name == "transport":
            self.count += int(event.figures.get("entries", 0))


@dataclass
class Timed:
    """What every frame of a stream took."""

    stream: Stream
    seconds: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    entries: list[int] = field(default_factory=list)
    points: list[int] = field(default_factory=list)


def streamed(
    clouds: Iterable[Floats], voxel: float, rate: float = 10.0, **settings: Any
) -> Iterator[Timed]:
    """Yield the same record after every frame."""
    counter = Entries()
    stream = Stream.from_config(hooks=[counter], **{"scene.voxel_size": voxel, **settings})
    timed = Timed(stream)
    for number, cloud in enumerate(clouds):
        counter.count = 0
        began, cpu = time.perf_counter(), time.thread_time()
        change = stream.push(cloud, stamp_ns=round((number + 1) * 1e9 / rate), frame_id="map")
        timed.cpu.append(time.thread_time() - cpu)
        timed.seconds.append(time.perf_counter() - began)
        timed.entries.append(counter.count)
        timed.points.append(change.figures.get("points", 0))
        yield timed


@dataclass(frozen=True)
class Cold:
    """A run without any memory on the points of a map."""

    skeleton: Skeleton
    seconds: float
    cpu: float
    entries: int


def cold(points: Floats, voxel: float | None = None) -> Cold:
    """Run the default pipeline.

    `voxel`, in input units, is the resolution that it is to keep where its own, a share of the
    scene's size, would be too coarse for a scene that is long and thin.
    """
    counter = Entries()
    settings: dict[str, float] = {}
    if voxel is not None:
        settings = {"downsample.voxel_size": voxel, "thin.voxel_size": 2.0 * voxel}
    with Pipeline.from_config("default", hooks=[counter], **settings) as pipe:
        began, cpu = time.perf_counter(), time.thread_time()
        skeleton = pipe.push(points)
        return Cold(skeleton, time.perf_counter() - began, time.thread_time() - cpu, counter.count)


def surface(stream: Stream) -> Floats:
    """Return the map's points."""
    assert stream.scene.world is not None
    return stream.scene.world.surface()


def errors(skeleton: Skeleton, truth: Truth) -> tuple[int, int, int]:
    """Return by how much components, cycles and leaves differ from the truth."""
    held = skeleton.summary()
    return (
        held["components"] - truth.components,
        held["cycles"] - truth.cycles,
        held["leaves"] - truth.leaves if truth.count_leaves else 0,
    )


def distance(one: Skeleton, other: Skeleton, diagonal: float) -> float:
    """Return the mean distance of two skeletons, both ways, in percent of the diagonal."""
    if not len(one) or not len(other):
        return float("nan")
    a, _ = densify(one.nodes, one.edges, diagonal / 1000)
    b, _ = densify(other.nodes, other.edges, diagonal / 1000)
    there, back = cKDTree(a).query(b)[0].mean(), cKDTree(b).query(a)[0].mean()
    return float(50.0 * (there + back) / diagonal)


def resident() -> int:
    """Return the resident memory of this process in bytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096


def run_orbit(views: Views, **settings: Any) -> tuple[Timed, list[Cold]]:
    """Stream an orbit; cold runs at three quarters of it and at its end, on the same maps."""
    colds = []
    half = len(views.clouds) // 2
    for timed in streamed(views.clouds, views.voxel, **settings):
        if len(timed.seconds) in (half + half // 2, len(views.clouds)):
            colds.append(cold(surface(timed.stream)))
    timed.stream.flush()
    return timed, colds


def quarters(values: list[float]) -> list[float]:
    """Return the means of four equal parts."""
    return [float(np.mean(part)) for part in np.array_split(values, 4)]
