"""Tubes and balls as copies of one mesh: what each copy is turned, stretched and moved by."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.arrays import IntArray
from mdcs_pipeline.viewer.colours import Colours


class Mesh(NamedTuple):
    """A triangle mesh, its faces counter-clockwise from outside.

    Parameters
    ----------
    vertices : (V, 3) float32
    faces : (F, 3) uint32
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]


class Copies(NamedTuple):
    """Where the copies of a mesh stand: scaled first, then turned, then moved.

    Parameters
    ----------
    positions : (M, 3) float32
    turns : (M, 4) float32
        Unit quaternions, w first.
    scales : (M, 3) float32
    colours : (M, 3) uint8
    """

    positions: NDArray[np.float32]
    turns: NDArray[np.float32]
    scales: NDArray[np.float32]
    colours: Colours


def unit_tube(sides: int = 12) -> Mesh:
    """Return an open tube of radius 1 about the z axis, from z = 0 to 1."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], axis=1)
    this = np.arange(sides)
    other = (this + 1) % sides
    lower = np.stack([this, other, other + sides], axis=1)
    upper = np.stack([this, other + sides, this + sides], axis=1)
    vertices = np.concatenate([ring, ring + np.array([0.0, 0.0, 1.0])])
    return Mesh(vertices.astype(np.float32), np.concatenate([lower, upper]).astype(np.uint32))


def unit_ball(sides: int = 12) -> Mesh:
    """Return a closed ball of radius 1 about the origin, of `sides` meridians."""
    rows = sides // 2
    height = np.pi * np.arange(1, rows) / rows
    angle = 2 * np.pi * np.arange(sides) / sides
    rings = [
        (np.sin(h) * np.cos(a), np.sin(h) * np.sin(a), np.cos(h)) for h in height for a in angle
    ]
    vertices = np.array([(0.0, 0.0, 1.0), *rings, (0.0, 0.0, -1.0)])
    this = 1 + np.arange(sides)
    other = 1 + (np.arange(sides) + 1) % sides
    faces = [np.stack([np.zeros_like(this), this, other], axis=1)]
    for row in range(rows - 2):
        above, below = row * sides, (row + 1) * sides
        faces.append(np.stack([this + above, this + below, other + below], axis=1))
        faces.append(np.stack([this + above, other + below, other + above], axis=1))
    last = (rows - 2) * sides
    faces.append(np.stack([this + last, np.full_like(this, len(vertices) - 1), other + last], 1))
    return Mesh(vertices.astype(np.float32), np.concatenate(faces).astype(np.uint32))


def turns_from_z(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit quaternions, w first, that take the z axis to (M, 3) unit directions."""
    x, y, z = directions.T
    turns = np.stack([1.0 + z, -y, x, np.zeros_like(z)], axis=1)
    # Straight down every half turn will do; the formula has none.
    turns[z < -1.0 + 1e-12] = (0.0, 1.0, 0.0, 0.0)
    turned: NDArray[np.float64] = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    return turned


def tube_copies(
    nodes: NDArray[np.float64], edges: IntArray, colours: Colours, radius: float
) -> Copies:
    """Return two copies of `unit_tube` for each edge: from either end to its middle.

    Parameters
    ----------
    nodes : (K, 3) float64
    edges : (E, 2) int64
        Edges without length are left out.
    colours : (E, 2, 3) uint8
        Of the half at each end.
    radius : float
        In the units of `nodes`.
    """
    ends = nodes[edges]
    halves = (ends.sum(axis=1, keepdims=True) / 2 - ends).reshape(-1, 3)
    length = np.linalg.norm(halves, axis=1)
    held = length > 0
    scales = np.stack([np.full_like(length, radius)] * 2 + [length], axis=1)
    return Copies(
        ends.reshape(-1, 3)[held].astype(np.float32),
        turns_from_z(halves[held] / length[held, None]).astype(np.float32),
        scales[held].astype(np.float32),
        colours.reshape(-1, 3)[held],
    )


def ball_copies(nodes: NDArray[np.float64], colours: Colours, radii: NDArray[np.float64]) -> Copies:
    """Return a copy of `unit_ball` for each of (K, 3) nodes, with (K,) radii."""
    turns = np.zeros((len(nodes), 4), np.float32)
    turns[:, 0] = 1.0
    scales = np.repeat(radii[:, None], 3, axis=1).astype(np.float32)
    return Copies(nodes.astype(np.float32), turns, scales, colours)
