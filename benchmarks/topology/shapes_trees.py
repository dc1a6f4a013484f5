"""Trees, hands, animals, blobs: tunable shapes without loops."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.topology.builder import Builder, grow_tree, spline
from benchmarks.topology.solid import Shape


def y() -> Shape:
    b = Builder("y")
    hub = b.node((0, 0, 0), 0.11)
    for tip in ((0, -1, 0), (0.8, 0.75, 0.1), (-0.8, 0.75, -0.1)):
        b.limb(hub, [tip], [0.07])
    return b.done(1, 0, 3)


def tree() -> Shape:
    b = Builder("tree")
    foot = b.node((0, 0, 0), 0.13)
    fork = b.limb(foot, [(0, 0, 0.9)], [0.1])
    grow_tree(b, fork, np.array([0.0, 0, 1]), 0.8, 0, [3, 2])
    return b.done(1, 0, 7)


def bush() -> Shape:
    b = Builder("bush")
    foot = b.node((0, 0, 0), 0.11)
    fork = b.limb(foot, [(0.05, 0, 0.6)], [0.09])
    grow_tree(b, fork, np.array([0.0, 0, 1]), 0.8, 0, [3, 2, 2])
    return b.done(1, 0, 13)


def _fingers(b: Builder, palm: int, count: int, gap: float, length: float) -> None:
    """Parallel fingers of radius 0.1; `gap` is in finger radii."""
    step = 0.1 * (2 + gap)
    for k in range(count):
        x = (k - (count - 1) / 2) * step
        reach = length * (1 - 0.12 * abs(k - (count - 1) / 2))
        b.limb(palm, [(x, 0, 0.5), (x, 0, 0.5 + reach)], [0.1, 0.085])


def hand5() -> Shape:
    b = Builder("hand5")
    wrist = b.node((0, 0, -1.1), 0.17)
    palm = b.limb(wrist, [(0, 0, -0.45), (0, 0, -0.05)], [0.2, 0.3])
    _fingers(b, palm, 4, 0.8, 0.85)
    b.limb(palm, [(0.45, 0, -0.02), (0.85, 0.05, 0.25)], [0.14, 0.09])
    return b.done(1, 0, 6)


def hand4() -> Shape:
    b = Builder("hand4")
    wrist = b.node((0, 0, -1.0), 0.2)
    palm = b.limb(wrist, [(0, 0, -0.1)], [0.3])
    _fingers(b, palm, 4, 0.5, 0.7)
    return b.done(1, 0, 5)


def quadruped() -> Shape:
    b = Builder("quadruped")
    hip = b.node((-0.5, 0, 0), 0.24)
    chest = b.limb(hip, [(0, 0, 0.02), (0.45, 0, 0)], [0.26, 0.25])
    for x, node in ((-0.5, hip), (0.45, chest)):
        for side in (-1, 1):
            b.limb(
                node,
                [(x, 0.17 * side, -0.25), (x + 0.03, 0.17 * side, -0.9)],
                [0.09, 0.06],
            )
    b.limb(hip, [(-0.78, 0, 0.12), (-1.05, 0, 0.1), (-1.35, 0, -0.15)], [0.045, 0.04, 0.025])
    b.limb(chest, [(0.7, 0, 0.4), (1.0, 0, 0.5)], [0.12, 0.1])
    return b.done(1, 0, 6)


def giraffe() -> Shape:
    b = Builder("giraffe")
    hip = b.node((-0.35, 0, 0), 0.19)
    chest = b.limb(hip, [(0.35, 0, 0.08)], [0.21])
    for x, node in ((-0.38, hip), (0.38, chest)):
        for side in (-1, 1):
            b.limb(node, [(x, 0.13 * side, -0.25), (x, 0.15 * side, -1.1)], [0.07, 0.045])
    b.limb(hip, [(-0.55, 0, 0.05), (-0.68, 0, -0.45)], [0.03, 0.02])
    head = b.limb(chest, [(0.55, 0, 0.4), (0.85, 0, 1.3)], [0.11, 0.085])
    b.limb(head, [(1.2, 0, 1.2)], [0.06])
    for side in (-1, 1):
        b.limb(head, [(0.75, 0.18 * side, 1.52)], [0.022])
    return b.done(1, 0, 8)


def humanoid() -> Shape:
    b = Builder("humanoid")
    pelvis = b.node((0, 0, 0), 0.17)
    chest = b.limb(pelvis, [(0, 0, 0.25), (0, 0, 0.5)], [0.16, 0.19])
    b.limb(chest, [(0, 0, 0.78), (0, 0, 0.98)], [0.075, 0.14])
    for side in (-1, 1):
        arm = [(0.27 * side, 0, 0.53), (0.6 * side, 0.03, 0.3), (0.85 * side, 0.15, 0.05)]
        b.limb(chest, arm, [0.085, 0.06, 0.045])
        leg = [(0.13 * side, 0, -0.2), (0.17 * side, 0.04, -0.6), (0.2 * side, 0, -1.05)]
        b.limb(pelvis, leg, [0.1, 0.075, 0.05])
    return b.done(1, 0, 5)


def insect() -> Shape:
    b = Builder("insect")
    tail = b.node((-1.0, 0, 0.05), 0.1)
    waist = b.limb(tail, [(-0.65, 0, 0.05), (-0.3, 0, 0)], [0.19, 0.07])
    thorax = b.limb(waist, [(0, 0, 0)], [0.14])
    for side in (-1, 1):
        for x in (-0.55, 0.0, 0.55):
            knee = (1.0 * x, 0.55 * side, 0.3)
            b.limb(
                thorax,
                [(0.15 * x, 0.12 * side, 0), knee, (1.5 * x, 0.95 * side, -0.35)],
                [0.04, 0.035, 0.025],
            )
    head = b.limb(thorax, [(0.25, 0, 0.02), (0.42, 0, 0.05)], [0.06, 0.12])
    for side in (-1, 1):
        b.limb(head, [(0.55, 0.05 * side, 0.14), (0.95, 0.3 * side, 0.45)], [0.025, 0.018])
    return b.done(1, 0, 9)


def dumbbell() -> Shape:
    b = Builder("dumbbell")
    bell = b.node((-0.8, 0, 0), 0.35)
    # The rod's end lies inside the bell: the change of radius is sudden, not a cone.
    b.limb(bell, [(-0.6, 0, 0), (0.6, 0, 0), (0.8, 0, 0)], [0.06, 0.06, 0.35])
    return b.done(1, 0, 2)


def lollipop() -> Shape:
    b = Builder("lollipop")
    ball = b.node((0, 0, 0), 0.4)
    b.limb(ball, [(0, 0, -0.2), (0.1, 0, -1.6)], [0.05, 0.035])
    return b.done(1, 0, 2)


def star5() -> Shape:
    b = Builder("star5")
    hub = b.node((0, 0, 0), 0.14)
    for angle in np.arange(5) * 2 * np.pi / 5:
        b.limb(hub, [(np.cos(angle), np.sin(angle), 0)], [0.04])
    return b.done(1, 0, 5)


def jack() -> Shape:
    b = Builder("jack")
    hub = b.node((0, 0, 0), 0.13)
    for tip in np.vstack([np.eye(3), -np.eye(3)]):
        b.limb(hub, [tip], [0.09])
    return b.done(1, 0, 6)


def whip() -> Shape:
    b = Builder("whip")
    path = spline([(0, 0, 0), (0.8, 0.25, 0), (1.6, -0.1, 0.3), (2.3, 0.2, 0.6), (3, 0, 0.2)], 60)
    b.curve(path, np.linspace(0.06, 0.012, 60))
    return b.done(1, 0, 2)


def _ellipsoid(name: str, long: float, short: float) -> Shape:
    """A prolate ellipsoid as the hull of its medial balls; the medial segment is the truth."""
    b = Builder(name)
    x = np.linspace(-1, 1, 9) * (long - short**2 / long)
    radius = short * np.sqrt(1 - x**2 / (long**2 - short**2))
    b.curve(np.stack([x, 0 * x, 0 * x], axis=1), radius)
    return b.done(1, 0, 2)


def egg() -> Shape:
    return _ellipsoid("egg", 1.0, 0.65)


def cigar() -> Shape:
    return _ellipsoid("cigar", 1.0, 0.4)


def cactus() -> Shape:
    """A thick trunk with parallel thinner arms."""
    b = Builder("cactus")
    foot = b.node((0, 0, -0.9), 0.24)
    low = b.limb(foot, [(0, 0, -0.1)], [0.22])
    high = b.limb(low, [(0, 0, 0.2)], [0.21])
    b.limb(high, [(0, 0, 1.0)], [0.18])
    for node, side, top in ((low, -1, 0.65), (high, 1, 0.9)):
        z = b.places[node][2]
        b.limb(
            node,
            [(0.2 * side, 0, z), (0.46 * side, 0, z + 0.05), (0.48 * side, 0, top)],
            [0.1, 0.1, 0.085],
        )
    return b.done(1, 0, 4)


def comb() -> Shape:
    b = Builder("comb")
    spine = b.curve(np.array([(0.24 * k, 0, 0) for k in range(7)]), 0.08)
    for node in spine:
        x = b.places[node][0]
        b.limb(node, [(x, 0, -0.75)], [0.055])
    return b.done(1, 0, 7)


MAKERS: tuple[Callable[[], Shape], ...] = (
    y, tree, bush, hand5, hand4, quadruped, giraffe, humanoid, insect, dumbbell, lollipop,
    star5, jack, whip, egg, cigar, cactus, comb,
)  # fmt: skip
