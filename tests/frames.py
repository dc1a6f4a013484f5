"""Frames of one scene: what an eye that goes round a shape sees of it."""

from __future__ import annotations

import numpy as np
import shapes
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: Edge of a voxel that suits the shapes below, in their unit.
VOXEL = 0.05
SETTINGS = {"scene.voxel_size": VOXEL}


def half(points: FloatArray, turn: float) -> FloatArray:
    """Return the points on one side of a plane through z: rough, but a frame."""
    way = np.array([np.cos(turn), np.sin(turn), 0.0])
    return points[points @ way > -0.1]


def orbit(count: int = 8, points: int = 6000, laps: float = 1.0, seed: int = 0) -> list[FloatArray]:
    """Return frames around the Y: each sees somewhat more than half of it."""
    return [half(shapes.y(points, seed + k), 2 * np.pi * laps * k / count) for k in range(count)]


def rod(start: float, end: float, count: int = 3000, seed: int = 0) -> FloatArray:
    """Return a piece of a long rod along x of radius 0.15, open at both ends."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0, 2 * np.pi, count)
    along = rng.uniform(start, end, count)
    return np.stack([along, 0.15 * np.cos(turn), 0.15 * np.sin(turn)], axis=1)
