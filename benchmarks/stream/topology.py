"""Must be shown, 1 and 2: topology and cost on orbits around objects."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from benchmarks.stream.run import distance, errors, run_orbit
from benchmarks.stream.scenes import orbit_views

SHAPES = (
    "y", "tree", "bush", "hand5", "hand4", "quadruped", "giraffe", "humanoid", "insect", "dumbbell",
    "lollipop", "star5", "jack", "cactus", "comb", "frame", "cube", "grid2", "ladder", "helix",
    "trefoil", "two_bars", "two_objects", "torus", "theta", "mug", "chair",
)  # fmt: skip

#: Of the shared data; their leaves are not counted.
MESHES = ("gel_hand", "gel_octopus", "gel_wolf", "rfalque_dog", "cloudcontr_fertility")
#: Also with poses that are off by this, in diagonals and radians.
JITTERED = ("y", "quadruped", "chair")
JITTER = 0.002


@dataclass(frozen=True)
class Orbit:
    """One orbit around one shape, streamed and cold."""

    name: str
    voxels: int
    streamed: tuple[int, int, int]
    cold: tuple[int, int, int]
    distance: float
    frame_seconds: float
    cold_seconds: float
    ratio: float
    cpu_ratio: float
    entries: float
    cold_entries: float

    @property
    def right(self) -> tuple[bool, bool]:
        """Whether the streamed and the cold skeleton have the truth's topology."""
        return not any(self.streamed), not any(self.cold)


def orbit(name: str, frames: int = 24, jitter: float = 0.0, **settings: Any) -> Orbit:
    """Stream one orbit and run cold on what it accumulated."""
    views = orbit_views(name, frames, jitter=jitter)
    truth = views.truth
    timed, colds = run_orbit(views, **settings)
    last, half = colds[-1].skeleton, frames // 2
    skeleton = timed.stream.skeleton()
    seconds = float(np.mean(timed.seconds[half:]))
    cold_seconds = float(np.mean([c.seconds for c in colds]))
    return Orbit(
        name=name if not jitter else f"{name}, jitter",
        voxels=len(timed.stream.scene.world.voxels) if timed.stream.scene.world else 0,
        streamed=errors(skeleton, truth),
        cold=errors(last, truth),
        distance=distance(skeleton, last, truth.diagonal),
        frame_seconds=seconds,
        cold_seconds=cold_seconds,
        ratio=cold_seconds / seconds,
        cpu_ratio=float(np.mean([c.cpu for c in colds]) / np.mean(timed.cpu[half:])),
        entries=float(np.mean(timed.entries[half:])),
        cold_entries=float(np.mean([c.entries for c in colds])),
    )


def as_record(found: Orbit) -> dict[str, Any]:
    """Return plain values."""
    return asdict(found)
