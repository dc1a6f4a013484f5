"""Problems with known answers: transport plans in closed form, shapes with exact skeletons."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Transport(NamedTuple):
    """A transport problem in the order of `sinkhorn.Problem`, and its plan, (n, m)."""

    points: FloatArray
    mass: FloatArray
    nodes: FloatArray
    target: FloatArray
    epsilon: float
    point_scale: FloatArray
    node_scale: FloatArray
    plan: FloatArray


class Shape(NamedTuple):
    """Points on a surface, and the curve skeleton that it was made around.

    `nodes` and `edges` follow the skeleton finely; `counts` are (components, cycles, leaves).
    """

    points: FloatArray
    nodes: FloatArray
    edges: IntArray
    radius: float
    counts: tuple[int, int, int]


def cost(
    points: FloatArray, nodes: FloatArray, point_scale: FloatArray, node_scale: FloatArray
) -> FloatArray:
    """Return ‖x_i − y_j‖²/(r_i r_j) as (n, m), written out."""
    square = np.square(points[:, None] - nodes[None]).sum(axis=2)
    return square / (point_scale[:, None] * node_scale[None])


def random_mass(rng: np.random.Generator, count: int) -> FloatArray:
    """Return positive masses that sum to 1."""
    mass = rng.uniform(0.2, 1.0, count)
    return mass / mass.sum()


def planted(seed: int, n: int, m: int, epsilon: float, scaled: bool = False) -> Transport:
    """Return the problem that a chosen plan solves.

    exp((f + g − c)/ε) is the one entropic plan of its own marginals, so that any f and g
    plant an answer; g only norms the rows.
    """
    rng = np.random.default_rng(seed)
    points, nodes = rng.uniform(0, 1, (n, 3)), rng.uniform(0, 1, (m, 3))
    point_scale = rng.uniform(0.5, 2.0, n) if scaled else np.ones(n)
    node_scale = rng.uniform(0.5, 2.0, m) if scaled else np.ones(m)
    # Potentials of a few ε, as transport to nodes of unequal mass has them.
    f = 3.0 * epsilon * rng.standard_normal(m)
    mass = random_mass(rng, n)
    exponent = (f - cost(points, nodes, point_scale, node_scale)) / epsilon
    rows = np.exp(exponent - exponent.max(axis=1, keepdims=True))
    plan = rows * (mass / rows.sum(axis=1))[:, None]
    return Transport(points, mass, nodes, plan.sum(axis=0), epsilon, point_scale, node_scale, plan)


def two_by_two(gap: float, epsilon: float, mass: float, target: float) -> Transport:
    """Return two points and two nodes, `gap` apart, whose plan is the root of a quadratic.

    A 2 × 2 plan has one unknown, p = π_00, and π_00 π_11 / (π_01 π_10) = exp(2 gap²/ε).
    """
    ends = np.array([[0.0, 0.0, 0.0], [gap, 0.0, 0.0]])
    ratio = np.exp(-2.0 * gap**2 / epsilon)
    # ratio · p (1 − a − b + p) = (a − p)(b − p), with a and b the first masses.
    a, b = mass, target
    roots = np.roots([1.0 - ratio, -(a + b) - ratio * (1.0 - a - b), a * b])
    p = float(next(r for r in roots.real if max(0.0, a + b - 1.0) <= r <= min(a, b)))
    plan = np.array([[p, a - p], [b - p, 1.0 - a - b + p]])
    ones = np.ones(2)
    return Transport(
        ends, np.array([a, 1 - a]), ends.copy(), np.array([b, 1 - b]), epsilon, ones, ones, plan
    )


def independent(seed: int, n: int, m: int, epsilon: float) -> Transport:
    """Return nodes on an axis and points in the plane across it.

    d_ij² is then a sum of a term of i and one of j, and the plan is the product of its
    marginals whatever ε is.
    """
    rng = np.random.default_rng(seed)
    points = np.column_stack([np.zeros(n), rng.uniform(-0.3, 0.3, (n, 2))])
    nodes = np.column_stack([rng.uniform(-0.3, 0.3, m), np.zeros((m, 2))])
    mass, target = random_mass(rng, n), random_mass(rng, m)
    return Transport(
        points, mass, nodes, target, epsilon, np.ones(n), np.ones(m), np.outer(mass, target)
    )


def rotation(seed: int) -> FloatArray:
    """Return a random proper rotation."""
    q, r = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else q[:, [1, 0, 2]]


def tube(axis: FloatArray, radius: float, count: int, rng: np.random.Generator) -> FloatArray:
    """Return points on the tube around a polyline, with half-spheres where it is open.

    A ring of points around each place of the axis lies across the tangent there, so that
    every point is `radius` from the curve that the polyline follows.
    """
    closed = bool(np.allclose(axis[0], axis[-1]))
    steps = np.linalg.norm(np.diff(axis, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    caps = 0.0 if closed else 2.0 * radius
    s = rng.uniform(-caps / 2, along[-1] + caps / 2, count)
    inside = np.clip(s, 0.0, along[-1])
    segment = np.minimum(np.searchsorted(along, inside, side="right") - 1, len(steps) - 1)
    share = ((inside - along[segment]) / steps[segment])[:, None]
    places = axis[segment] * (1 - share) + axis[segment + 1] * share
    tangents = np.gradient(axis, along, axis=0)
    if closed:
        tangents[0] = tangents[-1] = axis[1] - axis[-2]
    tangent = tangents[segment] * (1 - share) + tangents[segment + 1] * share
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    helper = np.eye(3)[np.argmin(np.abs(tangent), axis=1)]
    u = np.cross(tangent, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(tangent, u)
    angle = rng.uniform(0, 2 * np.pi, count)[:, None]
    # Archimedes: equal steps along the axis of a sphere hold equal areas.
    over = (s - inside)[:, None]
    across = np.sqrt(radius**2 - over**2)
    return places + across * (np.cos(angle) * u + np.sin(angle) * v) + over * tangent


def chain(count: int, first: int = 0, closed: bool = False) -> IntArray:
    """Return the edges of a chain of `count` nodes, or of a ring."""
    index = np.arange(first, first + count)
    edges = np.stack([index[:-1], index[1:]], axis=1)
    return np.concatenate([edges, [[first, first + count - 1]]]) if closed else edges


def line(count: int = 1500, radius: float = 0.1, seed: int = 0) -> Shape:
    """Return a straight capsule of length 1 between its centres."""
    nodes = np.linspace([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], 21)
    points = tube(nodes, radius, count, np.random.default_rng(seed))
    return Shape(points, nodes, chain(21), radius, (1, 0, 2))


def two_bars(count: int = 2000, radius: float = 0.1, gap: float = 0.6, seed: int = 0) -> Shape:
    """Return two parallel capsules whose axes are `gap` apart."""
    one, rng = np.linspace([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], 21), np.random.default_rng(seed)
    other = one + np.array([0.0, gap, 0.0])
    points = np.concatenate([tube(axis, radius, count // 2, rng) for axis in (one, other)])
    edges = np.concatenate([chain(21), chain(21, 21)])
    return Shape(points, np.concatenate([one, other]), edges, radius, (2, 0, 4))


def torus(count: int = 2000, ring: float = 0.5, radius: float = 0.12, seed: int = 0) -> Shape:
    """Return a torus, even by area, around a circle in the xy plane."""
    rng = np.random.default_rng(seed)
    angle, around = rng.uniform(0, 2 * np.pi, (2, 4 * count))
    # The outer side holds more area than the inner one.
    even = rng.uniform(0, ring + radius, 4 * count) < ring + radius * np.cos(around)
    angle, around = angle[even][:count], around[even][:count]
    reach = ring + radius * np.cos(around)
    height = radius * np.sin(around)
    points = np.stack([reach * np.cos(angle), reach * np.sin(angle), height], axis=1)
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    nodes = ring * np.stack([np.cos(turn), np.sin(turn), np.zeros(40)], axis=1)
    return Shape(points, nodes, chain(40, closed=True), radius, (1, 1, 0))


def helix(
    count: int = 3000, ring: float = 0.4, pitch: float = 0.5, radius: float = 0.07, seed: int = 0
) -> Shape:
    """Return the tube around two turns of a helix about the z axis."""
    turn = np.linspace(0, 4 * np.pi, 161)
    nodes = np.stack([ring * np.cos(turn), ring * np.sin(turn), pitch * turn / (2 * np.pi)], axis=1)
    points = tube(nodes, radius, count, np.random.default_rng(seed))
    return Shape(points, nodes, chain(161), radius, (1, 0, 2))


def y_shape(count: int = 2400, radius: float = 0.09, seed: int = 0) -> Shape:
    """Return the outside of three capsules that meet in the origin at 120°."""
    rng = np.random.default_rng(seed)
    angles = np.pi / 2 + np.arange(3) * 2 * np.pi / 3
    tips = 0.6 * np.stack([np.cos(angles), np.sin(angles), np.zeros(3)], axis=1)
    kept = []
    for arm in range(3):
        axis = np.linspace(np.zeros(3), tips[arm], 13)
        points = tube(axis, radius, count // 3, rng)
        others = np.delete(tips, arm, axis=0)
        inside = [_segment_distance(points, tip) < radius * (1 - 1e-9) for tip in others]
        kept.append(points[~np.any(inside, axis=0)])
    share = np.linspace(0, 1, 13)[1:, None]
    nodes = np.concatenate([np.zeros((1, 3)), *[share * tip for tip in tips]])
    edges = [[(0, 1 + 12 * arm), *chain(12, 1 + 12 * arm).tolist()] for arm in range(3)]
    return Shape(
        np.concatenate(kept), nodes, np.concatenate(edges).astype(np.int64), radius, (1, 0, 3)
    )


def _segment_distance(points: FloatArray, tip: FloatArray) -> FloatArray:
    """Return the distance of points to the segment from the origin to `tip`."""
    share = np.clip(points @ tip / (tip @ tip), 0.0, 1.0)
    return np.linalg.norm(points - share[:, None] * tip, axis=1)
