"""Frames, knots, coils, rings and separate objects: tunable shapes."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from benchmarks.topology.builder import Builder, circle
from benchmarks.topology.solid import Shape


def frame() -> Shape:
    b = Builder("frame")
    corners = np.array([(-0.8, -0.5, 0), (0.8, -0.5, 0), (0.8, 0.5, 0), (-0.8, 0.5, 0.0)])
    b.curve(corners, 0.08, closed=True)
    return b.done(1, 1, 0)


def cube() -> Shape:
    b = Builder("cube")
    for corner in np.ndindex(2, 2, 2):
        b.node(corner, 0.08)
    for i in range(8):
        for bit in (1, 2, 4):
            if not i & bit:
                b.edge(i, i | bit)
    return b.done(1, 5, 0)


def _grid(name: str, count: int, radius: float) -> Shape:
    b = Builder(name)
    side = count + 1
    for i, j in np.ndindex(side, side):
        b.node((0.5 * i, 0.5 * j, 0), radius)
    for i, j in np.ndindex(side, side):
        if i < count:
            b.edge(i * side + j, (i + 1) * side + j)
        if j < count:
            b.edge(i * side + j, i * side + j + 1)
    return b.done(1, count * count, 0)


def grid2() -> Shape:
    return _grid("grid2", 2, 0.1)


def grid3() -> Shape:
    return _grid("grid3", 3, 0.07)


def ladder() -> Shape:
    b = Builder("ladder")
    rails = [[b.node((x, 0, 0.4 * k), 0.06) for k in range(7)] for x in (-0.35, 0.35)]
    for rail in rails:
        for first, second in pairwise(rail):
            b.edge(first, second)
    for k in range(1, 6):
        b.edge(rails[0][k], rails[1][k])
    return b.done(1, 4, 4)


def helix() -> Shape:
    b = Builder("helix")
    t = np.linspace(0, 6 * np.pi, 90)
    b.curve(np.stack([0.5 * np.cos(t), 0.5 * np.sin(t), 0.07 * t], axis=1), 0.085)
    return b.done(1, 0, 2)


def trefoil() -> Shape:
    b = Builder("trefoil")
    t = np.arange(90) * 2 * np.pi / 90
    place = np.stack(
        [np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -1.0 * np.sin(3 * t)], axis=1
    )
    b.curve(place / 3, 0.15, closed=True)
    return b.done(1, 1, 0)


def coil() -> Shape:
    """A flat spiral with close turns."""
    b = Builder("coil")
    t = np.linspace(1.2 * np.pi, 5.2 * np.pi, 80)
    r = 0.27 / (2 * np.pi) * t
    b.curve(np.stack([r * np.cos(t), r * np.sin(t), 0 * t], axis=1), 0.085)
    return b.done(1, 0, 2)


def two_bars() -> Shape:
    b = Builder("two_bars")
    for z in (-0.14, 0.14):
        b.curve(np.array([(-0.9, 0, z), (0.9, 0, z)]), 0.1)
    return b.done(2, 0, 4)


def two_objects() -> Shape:
    """A ring and a Y that reach close to each other without touching."""
    b = Builder("two_objects")
    b.curve(circle((0, 0, 0), 0.6, 36), 0.12, closed=True)
    hub = b.node((0.98, 0, 0), 0.13)
    for tip in ((1.6, 0.6, 0), (1.6, -0.6, 0), (0.95, 0, 0.75)):
        b.limb(hub, [tip], [0.07])
    return b.done(2, 1, 3)


def torus() -> Shape:
    b = Builder("torus")
    b.curve(circle((0, 0, 0), 0.7, 48), 0.25, closed=True)
    return b.done(1, 1, 0)


def theta() -> Shape:
    b = Builder("theta")
    ring = b.curve(circle((0, 0, 0), 0.8, 40), 0.09, closed=True)
    b.edge(ring[0], ring[20])
    return b.done(1, 2, 0)


def mug() -> Shape:
    b = Builder("mug")
    foot = b.node((0, 0, -1.0), 0.26)
    low = b.limb(foot, [(0, 0, -0.3)], [0.3])
    high = b.limb(low, [(0, 0, 0.3)], [0.3])
    b.limb(high, [(0, 0, 1.0)], [0.26])
    angle = np.linspace(-0.5, 0.5, 13) * np.pi
    handle = np.stack([0.28 + 0.6 * np.cos(angle), 0 * angle, 0.42 * np.sin(angle)], axis=1)
    ends = b.curve(handle, 0.065)
    b.edge(low, ends[0])
    b.edge(high, ends[-1])
    return b.done(1, 1, 2)


def chair() -> Shape:
    b = Builder("chair")
    seat = [b.node((x, y, 0), 0.06) for x, y in ((0, 0), (0.8, 0), (0.8, 0.8), (0, 0.8))]
    for first, second in zip(seat, seat[1:] + seat[:1], strict=True):
        b.edge(first, second)
    for node in seat:
        x, y = b.places[node][:2]
        b.limb(node, [(x, y, -0.8)], [0.05])
    backs = [b.limb(node, [(*b.places[node][:2], 0.45)], [0.055]) for node in (seat[2], seat[3])]
    tops = [b.limb(node, [(*b.places[node][:2], 0.85)], [0.05]) for node in backs]
    b.edge(*backs)
    b.edge(*tops)
    return b.done(1, 3, 4)


MAKERS: tuple[Callable[[], Shape], ...] = (
    frame, cube, grid2, grid3, ladder, helix, trefoil, coil, two_bars, two_objects, torus,
    theta, mug, chair,
)  # fmt: skip
