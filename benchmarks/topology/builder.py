"""Putting shapes together from limbs, rings and curves."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.topology.solid import Floats, Shape

Place = Sequence[float] | Floats


class Builder:
    """Collects nodes and edges of one shape."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.places: list[Floats] = []
        self.radii: list[float] = []
        self.edges: list[tuple[int, int]] = []

    def node(self, place: Place, radius: float) -> int:
        """Add a node and return its index."""
        self.places.append(np.asarray(place, dtype=np.float64))
        self.radii.append(float(radius))
        return len(self.places) - 1

    def edge(self, first: int, second: int) -> None:
        """Join two nodes."""
        self.edges.append((first, second))

    def limb(self, start: int, places: Sequence[Place], radii: Sequence[float]) -> int:
        """Add a chain of nodes from `start` on and return the last one."""
        for place, radius in zip(places, radii, strict=True):
            last = self.node(place, radius)
            self.edge(start, last)
            start = last
        return start

    def curve(self, places: Floats, radii: Floats | float, closed: bool = False) -> list[int]:
        """Add a chain (a loop if `closed`) through `places` (K, 3) and return its nodes."""
        sizes = np.broadcast_to(np.asarray(radii, dtype=np.float64), len(places))
        made = [self.node(p, r) for p, r in zip(places, sizes, strict=True)]
        for first, second in pairwise(made):
            self.edge(first, second)
        if closed:
            self.edge(made[-1], made[0])
        return made

    def done(self, components: int, cycles: int, leaves: int) -> Shape:
        """Return the shape with the counts that its maker expects."""
        nodes, radius = np.array(self.places), np.array(self.radii)
        reach = radius[:, None]
        span = (nodes + reach).max(axis=0) - (nodes - reach).min(axis=0)
        return Shape(
            name=self.name,
            nodes=nodes,
            edges=np.array(self.edges, dtype=np.int64),
            radius=radius,
            components=components,
            cycles=cycles,
            leaves=leaves,
            diagonal=float(np.linalg.norm(span)),
        )


def spline(places: Sequence[Place], count: int) -> Floats:
    """Return `count` points of the cubic spline through `places`, ends included."""
    knots = np.asarray(places, dtype=np.float64)
    return np.asarray(
        CubicSpline(np.arange(len(knots)), knots)(np.linspace(0, len(knots) - 1, count))
    )


def circle(center: Place, radius: float, count: int, axes: tuple[int, int] = (0, 1)) -> Floats:
    """Return `count` points of a circle in a coordinate plane."""
    angle = np.arange(count) * 2 * np.pi / count
    points = np.tile(np.asarray(center, dtype=np.float64), (count, 1))
    points[:, axes[0]] += radius * np.cos(angle)
    points[:, axes[1]] += radius * np.sin(angle)
    return points


def unit(vector: Place) -> Floats:
    """Return the direction of a vector."""
    vector = np.asarray(vector, dtype=np.float64)
    return vector / np.linalg.norm(vector)


def grow_tree(
    build: Builder, start: int, direction: Floats, length: float, depth: int, fork: Sequence[int]
) -> None:
    """Grow a tapering tree from a node; `fork[k]` limbs leave at level k, turned each time."""
    if depth == len(fork):
        return
    place, radius = build.places[start], build.radii[start]
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    across = unit(np.cross(direction, helper))
    other = np.cross(direction, across)
    for k in range(fork[depth]):
        turn = 2 * np.pi * k / fork[depth] + 1.1 * depth
        lean = 0.75 if fork[depth] > 1 else 0.0
        side = np.cos(turn) * across + np.sin(turn) * other
        heading = unit(np.cos(lean) * direction + np.sin(lean) * side)
        tip = place + length * heading
        # A limb starts at its own thickness inside the parent, as branches do.
        root = build.limb(start, [place + 0.25 * length * heading], [0.72 * radius])
        end = build.limb(root, [tip], [0.6 * radius])
        grow_tree(build, end, heading, 0.78 * length, depth + 1, fork)
