"""Scenes to stream: orbits around shapes, a pipe network that grows, a moving object."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from benchmarks.stream.camera import Camera, orbit, parts_of
from benchmarks.topology import models
from benchmarks.topology.builder import Builder
from benchmarks.topology.shapes import make, sample
from benchmarks.topology.solid import Floats, Shape, Truth

#: Distance of two frames of a walk along the network, in input units.
STRIDE = 1.2
_BAY = 2.4


class Views(NamedTuple):
    """Frames of one scene.

    Parameters
    ----------
    truth : Truth
    clouds : list of (N, 3) float64
    voxel : float
        Edge of the map's voxels, in input units.
    """

    truth: Truth
    clouds: list[Floats]
    voxel: float


def orbit_views(
    name: str,
    frames: int,
    laps: float = 1.0,
    points: int = 20_000,
    noise: float = 0.0005,
    jitter: float = 0.0,
    seed: int = 0,
) -> Views:
    """Return frames of a camera that circles a shape or a mesh of the shared data.

    `noise` along the ray and `jitter` of the pose are in diagonals; the jitter is that of the
    camera's place, and of what lies one diagonal away by its turn.
    """
    truth: Truth
    if name in models.MESHES:
        truth, mesh = models.mesh_truth(name), models.mesh(name)
        parts, box = [mesh], (mesh[0].min(axis=0), mesh[0].max(axis=0))
    else:
        shape = make(name)
        truth, parts, box = shape, parts_of(shape), shape.box
    camera = Camera(parts, noise * truth.diagonal, seed)
    rng = np.random.default_rng(seed + 1)
    clouds = []
    for eye, target in orbit(box, frames, laps):
        cloud = camera.frame(eye, target, points)
        shift, turn = rng.normal(0.0, jitter, (2, 3))
        clouds.append(cloud + shift * truth.diagonal + np.cross(turn, cloud - target))
    return Views(truth, clouds, 0.015 * truth.diagonal)


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


#: Edge of the voxels for the network, in input units.
WALK_VOXEL = 0.075
_SIDES = ((0.0, -4.0, 3.0), (0.0, 4.0, 3.0), (0.0, -4.0, -3.0), (0.0, 4.0, -3.0))


def walk_views(
    frames: int, points: int = 20_000, noise: float = 0.01, seed: int = 0
) -> Iterator[Floats]:
    """Yield frames of a camera that walks along `network`, now on its one side, now the other."""
    camera = Camera(parts_of(network(frames)), noise, seed)
    for k in range(frames):
        at = np.array([k * STRIDE, 1.0, 0.0])
        yield camera.frame(at + np.array(_SIDES[k % 4]), at, points, angle=46.0)


def dancing(count: int, points: int = 20_000) -> Iterator[Floats]:
    """Yield whole clouds of a figure that turns in its length and wanders, for replace mode."""
    shape = make("humanoid")
    for k in range(count):
        cloud = sample(shape, points, np.random.default_rng(k)).points
        height = (cloud[:, 2] - cloud[:, 2].min()) / shape.diagonal
        angle = 0.5 * np.sin(0.15 * k) * height
        turned = cloud.copy()
        turned[:, 0] = np.cos(angle) * cloud[:, 0] - np.sin(angle) * cloud[:, 1]
        turned[:, 1] = np.sin(angle) * cloud[:, 0] + np.cos(angle) * cloud[:, 1]
        yield turned + np.array([0.003 * k * shape.diagonal, 0.0, 0.0])
