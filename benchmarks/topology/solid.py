"""Solids that are unions of round cones along a graph: signed distance, sampling, rays.

A round cone is the convex hull of two balls, so a solid is wholly given by its graph: positions,
radii and edges. The same graph is the ground truth of its curve skeleton.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def graph_counts(count: int, edges: Ints) -> tuple[int, int, int]:
    """Return components, independent cycles and leaves of a graph of `count` nodes."""
    edges = np.asarray(edges, dtype=np.int64).reshape(-1, 2)
    if count == 0:
        return 0, 0, 0
    edges = np.unique(np.sort(edges, axis=1), axis=0)
    ones = np.ones(len(edges))
    matrix = coo_array((ones, (edges[:, 0], edges[:, 1])), shape=(count, count))
    pieces = int(connected_components(matrix, directed=False)[0])
    degree = np.bincount(edges.ravel(), minlength=count)
    return pieces, len(edges) - count + pieces, int(np.count_nonzero(degree == 1))


@dataclass(frozen=True, eq=False)
class Truth:
    """The expected skeleton: geometry where it is known, counts always.

    `nodes` is (K, 3) and may be empty when only the counts are known; `radius` is (K,) or None;
    `diagonal` scales the distances; leaves count as errors only with `count_leaves`.
    """

    name: str
    nodes: Floats
    edges: Ints
    radius: Floats | None
    components: int
    cycles: int
    leaves: int
    diagonal: float
    count_leaves: bool = True


@dataclass(frozen=True, eq=False)
class Sample:
    """Points on a surface, with what the maker knows about each of them.

    `points` and `normals` are (N, 3), `radius` (N,) is the local tube radius, and `edge` (N,)
    names an edge of the graph that the point belongs to (-1: unknown, as for outliers).
    """

    points: Floats
    normals: Floats
    radius: Floats
    edge: Ints

    def __len__(self) -> int:
        return len(self.points)

    def take(self, which: NDArray[np.generic]) -> Sample:
        """Return the chosen points."""
        return Sample(self.points[which], self.normals[which], self.radius[which], self.edge[which])

    def moved(self, points: Floats) -> Sample:
        """Return the same points at other places."""
        return Sample(points, self.normals, self.radius, self.edge)


def join(samples: list[Sample]) -> Sample:
    """Return the samples as one."""
    return Sample(
        np.concatenate([s.points for s in samples]),
        np.concatenate([s.normals for s in samples]),
        np.concatenate([s.radius for s in samples]),
        np.concatenate([s.edge for s in samples]),
    )


@dataclass(frozen=True, eq=False)
class Shape(Truth):
    """A union of round cones, one an edge; every node has a radius."""

    @cached_property
    def balls(self) -> Floats:
        """Radius per node, as an array that is never None."""
        assert self.radius is not None
        return self.radius

    @cached_property
    def box(self) -> tuple[Floats, Floats]:
        """Corners of the solid's own bounding box."""
        reach = self.balls[:, None]
        return (self.nodes - reach).min(axis=0), (self.nodes + reach).max(axis=0)

    @cached_property
    def branches(self) -> Ints:
        """Branch of each edge: edges that meet at a node of degree 2 share one."""
        degree = np.bincount(self.edges.ravel(), minlength=len(self.nodes))
        rows, columns = [], []
        for node in np.flatnonzero(degree == 2):
            first, second = np.flatnonzero((self.edges == node).any(axis=1))
            rows.append(first)
            columns.append(second)
        size = len(self.edges)
        matrix = coo_array((np.ones(len(rows)), (rows, columns)), shape=(size, size))
        return connected_components(matrix, directed=False)[1].astype(np.int64)


@dataclass(frozen=True)
class Cone:
    """Frame of one edge: start, unit axis, length, radii and the sine of the side's slope."""

    start: Floats
    axis: Floats
    length: float
    radii: tuple[float, float]
    sine: float


def cones(shape: Shape) -> list[Cone]:
    """Return the frame of every edge."""
    found = []
    for i, j in shape.edges:
        step = shape.nodes[j] - shape.nodes[i]
        length = float(np.linalg.norm(step))
        first, second = float(shape.balls[i]), float(shape.balls[j])
        sine = (first - second) / length
        found.append(Cone(shape.nodes[i], step / length, length, (first, second), sine))
    return found


def cone_distance(cone: Cone, points: Floats) -> Floats:
    """Signed distance (N,) to one round cone, negative inside.

    It is the least of |p − c(t)| − r(t) over the balls of the edge; the minimum is at
    t L = s − q tan a, with s along the axis, q away from it and sin a = (r0 − r1) / L.
    """
    offset = points - cone.start
    along = offset @ cone.axis
    away = np.sqrt(np.maximum(np.einsum("ij,ij->i", offset, offset) - along**2, 0.0))
    if abs(cone.sine) >= 1.0:
        foot = np.full(len(points), 0.0 if cone.sine > 0 else cone.length)
    else:
        tangent = cone.sine / np.sqrt(1.0 - cone.sine**2)
        foot = np.clip(along - away * tangent, 0.0, cone.length)
    return np.hypot(along - foot, away) - (cone.radii[0] - foot * cone.sine)


def signed_distance(shape: Shape, points: Floats) -> Floats:
    """Signed distance (N,) to the union: exact outside, a bound inside, right in sign."""
    best = np.full(len(points), np.inf)
    for cone in cones(shape):
        np.minimum(best, cone_distance(cone, points), out=best)
    return best


def _directions(count: int, rng: np.random.Generator) -> Floats:
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _side_points(cone: Cone, count: int, rng: np.random.Generator) -> Sample:
    """Area-uniform points on the tangent frustum; its area element grows with r(t)."""
    first, second = cone.radii
    share = rng.random(count)
    if np.isclose(first, second):
        part = share
    else:
        part = (np.sqrt(first**2 + share * (second**2 - first**2)) - first) / (second - first)
    helper = np.eye(3)[np.argmin(np.abs(cone.axis))]
    across = np.cross(cone.axis, helper)
    across /= np.linalg.norm(across)
    other = np.cross(cone.axis, across)
    angle = rng.random(count) * 2 * np.pi
    ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * other
    normals = np.sqrt(1.0 - cone.sine**2) * ring + cone.sine * cone.axis
    radius = first + part * (second - first)
    points = cone.start + np.outer(part * cone.length, cone.axis) + radius[:, None] * normals
    return Sample(points, normals, radius, np.full(count, -1))


def _draw(shape: Shape, count: int, rng: np.random.Generator) -> Sample:
    """Area-uniform points on all node spheres and all edge sides, hidden ones included."""
    frames = cones(shape)
    spheres = 4 * np.pi * shape.balls**2
    sides = np.array([np.pi * c.length * max(1.0 - c.sine**2, 0.0) * sum(c.radii) for c in frames])
    area = np.concatenate([spheres, sides])
    shares = rng.multinomial(count, area / area.sum())
    pieces = []
    for node, share in enumerate(shares[: len(spheres)]):
        normals = _directions(share, rng)
        points = shape.nodes[node] + shape.balls[node] * normals
        owner = np.flatnonzero((shape.edges == node).any(axis=1))[0]
        radius = np.full(share, shape.balls[node])
        pieces.append(Sample(points, normals, radius, np.full(share, owner)))
    for index, share in enumerate(shares[len(spheres) :]):
        if share:
            side = _side_points(frames[index], share, rng)
            pieces.append(Sample(side.points, side.normals, side.radius, np.full(share, index)))
    return join(pieces)


def sample(shape: Shape, n: int, rng: np.random.Generator) -> Sample:
    """Return `n` points spread uniformly by area over the surface of the union.

    Spheres are drawn once a node, so joints are not counted twice; points inside any round cone
    are rejected, which leaves the rest uniform on what can be seen from outside.
    """
    kept: list[Sample] = []
    have, batch = 0, 2 * n
    while have < n:
        drawn = _draw(shape, batch, rng)
        outside = signed_distance(shape, drawn.points) > -1e-7 * shape.diagonal
        kept.append(drawn.take(outside))
        have += len(kept[-1])
        rate = max(outside.mean(), 0.02)
        batch = int(1.2 * (n - have) / rate) + 200
    full = join(kept)
    return full.take(rng.permutation(len(full))[:n])


def _hits_ball(
    center: Floats, radius: float, points: Floats, rays: Floats, near: float
) -> NDArray[np.bool_]:
    offset = points - center
    middle = np.einsum("ij,ij->i", offset, rays)
    rest = middle**2 - np.einsum("ij,ij->i", offset, offset) + radius**2
    return (rest > 0) & (-middle + np.sqrt(np.maximum(rest, 0.0)) > near) & (middle < 0)


def _hits_side(cone: Cone, points: Floats, rays: Floats, near: float) -> NDArray[np.bool_]:
    """Rays that meet the frustum: a quadratic, as q = (r0 − s sin a) / cos a on it."""
    if abs(cone.sine) >= 1.0:
        return np.zeros(len(points), dtype=bool)
    offset = points - cone.start
    along, rate = offset @ cone.axis, rays @ cone.axis
    cosine = np.sqrt(1.0 - cone.sine**2)
    line, slope = (cone.radii[0] - along * cone.sine) / cosine, -rate * cone.sine / cosine
    a = 1.0 - rate**2 - slope**2
    b = np.einsum("ij,ij->i", offset, rays) - along * rate - line * slope
    c = np.einsum("ij,ij->i", offset, offset) - along**2 - line**2
    rest = b**2 - a * c
    root = np.sqrt(np.maximum(rest, 0.0))
    low, high = cone.radii[0] * cone.sine, cone.length + cone.radii[1] * cone.sine
    hit = np.zeros(len(points), dtype=bool)
    for sign in (-1.0, 1.0):
        with np.errstate(divide="ignore", invalid="ignore"):
            time = (-b + sign * root) / a
        place = along + time * rate
        hit |= (rest > 0) & (time > near) & (place >= low) & (place <= high)
    return hit


def hidden(shape: Shape, points: Floats, camera: Floats) -> NDArray[np.bool_]:
    """Return which surface points (N, 3) the solid itself hides from a camera (3,)."""
    rays = camera - points
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    near = 1e-5 * shape.diagonal
    blocked = np.zeros(len(points), dtype=bool)
    for center, radius in zip(shape.nodes, shape.balls, strict=True):
        blocked |= _hits_ball(center, float(radius), points, rays, near)
    for cone in cones(shape):
        blocked |= _hits_side(cone, points, rays, near)
    return blocked
