"""Shapes drawn by chance: what nobody had in mind when the method was made.

A shape grows limb by limb: each starts at a node that is there, bends, tapers, and stays if the
audit finds room around it. Then some ends are joined, which makes loops. What the audit does not
pass as a whole is drawn anew, so a seed always gives the same shape, and a valid one.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import combinations, count

import numpy as np

from benchmarks.topology.audit import clearance, solid_counts, spur_reach
from benchmarks.topology.builder import Builder, spline, unit
from benchmarks.topology.solid import Floats, Shape, graph_counts

#: Those that may be looked at and tuned on, and those that may not.
NAMES = tuple(f"random{k}" for k in range(24))
HELD_OUT = tuple(f"random{k}" for k in range(24, 48))
# Least room between limbs, and by how much each end sticks out, in the thinner's radii.
_ROOM, _REACH = 0.8, 2.0
# Largest cosine between limbs at a node: at a sharper corner they are one limb for a while.
_CORNER = 0.35
_PIECES = 6
_TRIES = 12


@cache
def random_shape(name: str) -> Shape:
    """Return the shape called ``randomN``."""
    seed = int(name.removeprefix("random"))
    drawn = (_drawn(name, np.random.default_rng([seed, attempt])) for attempt in count())
    return next(shape for shape in drawn if _valid(shape))


def _valid(shape: Shape) -> bool:
    """Return whether it has more than one limb, and the counts of its graph are the solid's."""
    return (
        len(shape.edges) >= 2 * _PIECES
        and spur_reach(shape) > _REACH
        and solid_counts(shape, 160) == (shape.components, shape.cycles, 0)
    )


def _drawn(name: str, rng: np.random.Generator) -> Shape:
    build = Builder(name)
    build.node((0, 0, 0), rng.uniform(0.12, 0.3))
    for _ in range(int(rng.integers(2, 9))):
        _tried(build, rng, _limb)
    for _ in range(int(rng.integers(0, 4))):
        _tried(build, rng, _handle)
    return _counted(build)


def _counted(build: Builder) -> Shape:
    edges = np.array(build.edges, dtype=np.int64).reshape(-1, 2)
    return build.done(*graph_counts(len(build.places), edges))


def _tried(
    build: Builder, rng: np.random.Generator, add: Callable[[Builder, np.random.Generator], bool]
) -> None:
    """Add something, if one of a few draws leaves room around it."""
    for _ in range(_TRIES):
        before = len(build.places), len(build.edges)
        added = add(build, rng)
        if added and _sharpest(build) <= _CORNER and clearance(_counted(build)) >= _ROOM:
            return
        del build.places[before[0] :], build.radii[before[0] :], build.edges[before[1] :]


def _sharpest(build: Builder) -> float:
    """Return the largest cosine between two edges that leave one node."""
    places = np.array(build.places)
    near: list[list[Floats]] = [[] for _ in places]
    for i, j in build.edges:
        near[i].append(unit(places[j] - places[i]))
        near[j].append(unit(places[i] - places[j]))
    return max(
        (float(a @ b) for ways in near for a, b in combinations(ways, 2)),
        default=-1.0,
    )


def _degree(build: Builder) -> Floats:
    ends = np.array(build.edges, dtype=np.int64).ravel()
    return np.bincount(ends, minlength=len(build.places)).astype(np.float64)


def _limb(build: Builder, rng: np.random.Generator) -> bool:
    """Grow a bent limb from a node with few edges; ends are as likely as all others together."""
    degree = _degree(build)
    weight = np.where(degree <= 1, 3.0, np.where(degree < 4, 0.3, 0.0))
    start = int(rng.choice(len(degree), p=weight / weight.sum()))
    place, thick = build.places[start], build.radii[start]
    radius = max(0.04, thick * rng.uniform(0.35, 0.95))
    reach = thick + radius * rng.uniform(4.0, 14.0)
    heading = unit(rng.standard_normal(3))
    bend = unit(np.cross(heading, rng.standard_normal(3))) * reach * rng.uniform(0.0, 0.3)
    knots = [place, place + 0.5 * reach * heading + bend, place + reach * heading]
    radii = np.linspace(radius, radius * rng.uniform(0.6, 1.0), _PIECES)
    build.limb(start, list(spline(knots, _PIECES + 1)[1:]), list(radii))
    return True


def _handle(build: Builder, rng: np.random.Generator) -> bool:
    """Join two ends, or an end and another node, by an arc."""
    degree = _degree(build)
    ends = np.flatnonzero(degree == 1)
    if len(ends) < 1 or len(degree) < 3:
        return False
    first = int(rng.choice(ends))
    second = int(rng.choice(np.flatnonzero((degree < 3) & (np.arange(len(degree)) != first))))
    one, other = build.places[first], build.places[second]
    width = float(np.linalg.norm(other - one))
    out = unit((one + other) / 2 - np.mean(build.places, axis=0) + 1e-3)
    middle = (one + other) / 2 + out * width * rng.uniform(0.2, 0.9)
    path = spline([one, middle, other], 2 * _PIECES)[1:-1]
    radii = np.linspace(build.radii[first], build.radii[second], len(path) + 2)[1:-1]
    last = build.limb(first, list(path), list(np.minimum(radii, radii.min() * 1.5)))
    build.edge(last, second)
    return True
