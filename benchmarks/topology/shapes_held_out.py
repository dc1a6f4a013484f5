"""Shapes that no constant may be tuned on; they differ in kind from those that may."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.topology.builder import Builder, circle, grow_tree, spline
from benchmarks.topology.solid import Shape


def octopus() -> Shape:
    b = Builder("octopus")
    head = b.node((0, 0, 0.8), 0.32)
    body = b.limb(head, [(0, 0, 0.1)], [0.22])
    for angle in np.arange(8) * np.pi / 4:
        c, s = np.cos(angle), np.sin(angle)
        knots = [(0.24, -0.02), (0.6, -0.2), (1.0, -0.15), (1.4, -0.35 + 0.12 * np.cos(3 * angle))]
        path = spline([(c * r, s * r, z) for r, z in knots], 12)
        b.limb(body, list(path), list(np.linspace(0.085, 0.03, 12)))
    return b.done(1, 0, 9)


def bicycle() -> Shape:
    b = Builder("bicycle")
    rear = b.curve(circle((-0.85, 0, 0), 0.5, 40, (0, 2)), 0.04, closed=True)
    front = b.curve(circle((0.95, 0, 0), 0.5, 40, (0, 2)), 0.04, closed=True)
    crank, saddle, stem = (
        b.node(p, 0.045) for p in ((0.05, 0, -0.1), (-0.15, 0, 0.6), (0.6, 0, 0.65))
    )
    for first, second in ((crank, saddle), (saddle, stem), (stem, crank)):
        b.edge(first, second)
    # Frame and fork hold the wheels by the rim, since the wheels have no spokes.
    b.edge(rear[0], crank)
    b.edge(rear[10], saddle)
    b.edge(front[15], stem)
    bar = b.limb(stem, [(0.55, 0, 0.85)], [0.04])
    for side in (-1, 1):
        b.limb(bar, [(0.45, 0.35 * side, 0.88)], [0.035])
    return b.done(1, 4, 2)


def spiral_stair() -> Shape:
    b = Builder("spiral_stair")
    turn = np.arange(9) * 0.75
    column = b.curve(np.array([(0, 0, 0.28 * k) for k in range(-1, 10)]), 0.08)
    railing = []
    for k, angle in enumerate(turn):
        for part in np.linspace(0, 1, 5)[: 5 if k < 8 else 1]:
            if part < 1:
                a = angle + 0.75 * part
                railing.append((0.65 * np.cos(a), 0.65 * np.sin(a), 0.28 * (k + part)))
    rail = b.curve(np.array(railing), 0.06)
    for k in range(9):
        b.edge(column[k + 1], rail[4 * k])
    return b.done(1, 8, 2)


def spring_rod() -> Shape:
    """A rod runs through a spring and touches it nowhere."""
    b = Builder("spring_rod")
    t = np.linspace(0, 8 * np.pi, 110)
    b.curve(np.stack([0.4 * np.cos(t), 0.4 * np.sin(t), 0.055 * t], axis=1), 0.07)
    b.curve(np.array([(0, 0, -0.35), (0, 0, 1.75)]), 0.11)
    return b.done(2, 0, 4)


def tree25() -> Shape:
    b = Builder("tree25")
    foot = b.node((0, 0, -0.4), 0.17)
    fork = b.limb(foot, [(0, 0, 0.7)], [0.13])
    grow_tree(b, fork, np.array([0.0, 0, 1]), 1.2, 0, [4, 3, 2])
    return b.done(1, 0, 25)


def hand_splayed() -> Shape:
    b = Builder("hand_splayed")
    wrist = b.node((0, 0, -0.9), 0.17)
    palm = b.limb(wrist, [(0, 0, -0.3), (0, 0, 0)], [0.19, 0.27])
    for angle, reach in zip(
        np.radians([-80, -38, -12, 14, 42]), (0.8, 1.1, 1.2, 1.15, 1.0), strict=True
    ):
        heading = np.array([np.sin(angle), 0.25 * np.sin(2 * angle), np.cos(angle)])
        b.limb(palm, [0.4 * heading, reach * heading], [0.085, 0.06])
    return b.done(1, 0, 6)


def chain3() -> Shape:
    b = Builder("chain3")
    for k in range(3):
        axes = (0, 1) if k % 2 == 0 else (0, 2)
        b.curve(circle((0.72 * k, 0, 0), 0.5, 36, axes), 0.08, closed=True)
    return b.done(3, 3, 0)


def pretzel() -> Shape:
    b = Builder("pretzel")
    outer = spline(
        [(0, -0.75, 0), (0.65, -0.45, 0), (0.85, 0.2, 0), (0.4, 0.62, 0), (0, 0.25, 0.0)], 24
    )
    low = b.node(outer[0], 0.11)
    cross = b.node(outer[-1], 0.11)
    for side in (1, -1):
        path = outer * [side, 1, 1]
        made = b.curve(path[1:-1], 0.11)
        b.edge(low, made[0])
        b.edge(made[-1], cross)
        foot = made[3]
        tail = spline([b.places[cross], (-0.12 * -side, -0.1, 0), b.places[foot]], 7)[1:-1]
        strand = b.curve(tail, 0.1)
        b.edge(cross, strand[0])
        b.edge(strand[-1], foot)
    return b.done(1, 3, 0)


MAKERS: tuple[Callable[[], Shape], ...] = (
    octopus, bicycle, spiral_stair, spring_rod, tree25, hand_splayed, chain3, pretzel,
)  # fmt: skip

HELD_OUT: dict[str, Callable[[], Shape]] = {maker.__name__: maker for maker in MAKERS}
