"""Scenes to stream: orbits around shapes, a pipe network that grows, a moving object."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from benchmarks.stream.camera import Camera, orbit
from benchmarks.topology.builder import Builder
from benchmarks.topology.solid import Floats, Shape

#: Distance of two frames of a walk along the network, in input units.
STRIDE = 0.4
_BAY = 2.4


class Views(NamedTuple):
    """Frames of one scene.

    Parameters
    ----------
    shape : Shape
        The truth.
    clouds : list of (N, 3) float64
    voxel : float
        Edge of the map's voxels, in input units.
    """

    shape: Shape
    clouds: list[Floats]
    voxel: float


def orbit_views(
    shape: Shape,
    frames: int,
    laps: float = 1.0,
    points: int = 20_000,
    noise: float = 0.0005,
    jitter: float = 0.0,
    seed: int = 0,
) -> Views:
    """Return frames of a camera that circles a shape.

    `noise` along the ray and `jitter` of the pose are in diagonals; the jitter is that of the
    camera's place, and of what lies one diagonal away by its turn.
    """
    camera = Camera(shape, noise * shape.diagonal, seed)
    rng = np.random.default_rng(seed + 1)
    clouds = []
    for eye, target in orbit(shape, frames, laps):
        cloud = camera.frame(eye, target, points)
        shift = rng.normal(0.0, jitter * shape.diagonal, 3) if jitter else np.zeros(3)
        turn = rng.normal(0.0, jitter, 3) if jitter else np.zeros(3)
        clouds.append(cloud + shift + np.cross(turn, cloud - target))
    return Views(shape, clouds, 0.015 * shape.diagonal)


def network(frames: int) -> Shape:
    """Return two pipes side by side, with rungs that close loops and arms that end."""
    build = Builder(f"network{frames}")
    bays = max(1, int(np.ceil((frames - 1) * STRIDE / _BAY)))
    rails = []
    for side in (0, 1):
        places = [(k * _BAY, 2.0 * side, 0.25 * np.sin(0.9 * k + side)) for k in range(bays + 1)]
        rails.append(build.curve(np.array(places), 0.26 - 0.05 * side))
    for k in range(0, bays + 1, 2):
        build.edge(rails[0][k], rails[1][k])
    arms = 0
    for k in range(1, bays, 2):
        start = rails[arms % 2][k]
        out = -1.3 if arms % 2 == 0 else 1.3
        tip = build.places[start] + np.array([0.2, out, 0.5])
        build.edge(start, build.node(tip, 0.17))
        arms += 1
    rungs = len(range(0, bays + 1, 2))
    # Rails end where no rung joins them.
    loose = 0 if bays % 2 == 0 else 2
    return build.done(1, rungs - 1, arms + loose)


def walk_views(
    frames: int, points: int = 20_000, noise: float = 0.01, seed: int = 0
) -> Iterator[Floats]:
    """Yield frames of a camera that walks along `network`, now on its one side, now the other."""
    camera = Camera(network(frames), noise, seed)
    for k in range(frames):
        at = np.array([k * STRIDE, 1.0, 0.0])
        side = ((0.0, -4.0, 3.0), (0.0, 4.0, 3.0), (0.0, -4.0, -3.0), (0.0, 4.0, -3.0))[k % 4]
        yield camera.frame(at + np.array(side), at, points, angle=46.0)


#: Edge of the voxels for the network, in input units.
WALK_VOXEL = 0.075
