"""Clouds of known topology, evenly sampled; the same seed gives the same cloud."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: Radius of the ring and of the tube of `torus`.
RING, TUBE = 1.0, 0.25


class Cone(NamedTuple):
    """A cone with half a ball at each end; its axis and the radius at both ends."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radii: tuple[float, float]

    def areas(self) -> FloatArray:
        """Return the area of the first cap, of the side and of the last cap."""
        first, last = self.radii
        length = np.linalg.norm(np.subtract(self.end, self.start))
        side = np.pi * (first + last) * np.hypot(length, last - first)
        return np.array([2 * np.pi * first**2, side, 2 * np.pi * last**2])

    def sample(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return points spread evenly over the skin."""
        start, end = np.array(self.start), np.array(self.end)
        first, last = self.radii
        axis = end - start
        along = axis / np.linalg.norm(axis)
        way = directions(count, rng)
        height = way @ along
        across = way - height[:, None] * along
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        # Circles count by their circumference: uniform in the square of the radius.
        drawn = rng.uniform(size=count)
        wide = np.sqrt(first**2 + drawn * (last**2 - first**2))
        share = drawn if first == last else (wide - first) / (last - first)
        outward = way * np.sign(height)[:, None]
        places = np.stack(
            [
                start - first * outward,
                start + share[:, None] * axis + wide[:, None] * across,
                end + last * outward,
            ]
        )
        part = rng.choice(3, count, p=self.areas() / self.areas().sum())
        chosen: FloatArray = places[part, np.arange(count)]
        return chosen

    def holds(self, points: FloatArray) -> NDArray[np.bool_]:
        """Return which points lie inside."""
        start = np.array(self.start)
        axis = np.array(self.end) - start
        share = np.clip((points - start) @ axis / (axis @ axis), 0, 1)
        gap = np.linalg.norm(points - start - share[:, None] * axis, axis=1)
        first, last = self.radii
        return np.asarray(gap < first + share * (last - first))


#: Three limbs of unequal length, thickness and direction: no symmetry but that of a plane.
Y_LIMBS = (
    Cone((0, 0, 0), (0, -1.0, 0.05), (0.14, 0.10)),
    Cone((0, 0, 0), (0.85, 0.6, 0.1), (0.14, 0.09)),
    Cone((0, 0, 0), (-0.7, 0.75, -0.12), (0.14, 0.08)),
)
TWO_BARS = (
    Cone((-1, -0.5, 0), (1, -0.5, 0.1), (0.12, 0.12)),
    Cone((-0.9, 0.5, 0), (1, 0.55, 0), (0.12, 0.12)),
)


def directions(count: int, rng: np.random.Generator) -> FloatArray:
    """Return unit vectors spread evenly over the sphere."""
    drawn = rng.normal(size=(count, 3))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def skin(cones: tuple[Cone, ...], count: int, seed: int) -> FloatArray:
    """Return about `count` points on the skin of the cones' union, in mixed order."""
    rng = np.random.default_rng(seed)
    area = np.array([cone.areas().sum() for cone in cones])
    drawn = []
    for cone, share in zip(cones, area / area.sum(), strict=True):
        points = cone.sample(round(share * count), rng)
        inside = [other.holds(points) for other in cones if other is not cone]
        drawn.append(points[~np.any(inside, axis=0)] if inside else points)
    return rng.permutation(np.concatenate(drawn))


def torus(count: int = 2000, seed: int = 0) -> FloatArray:
    """Return a ring around z: one loop, no ends."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0, 2 * np.pi, 3 * count)
    # The outer side has more surface than the inner one.
    kept = rng.uniform(0, RING + TUBE, 3 * count) < RING + TUBE * np.cos(turn)
    turn = turn[kept][:count]
    around = rng.uniform(0, 2 * np.pi, len(turn))
    distance = RING + TUBE * np.cos(turn)
    return np.stack(
        [distance * np.cos(around), distance * np.sin(around), TUBE * np.sin(turn)], axis=1
    )


def y(count: int = 2000, seed: int = 0) -> FloatArray:
    """Return three limbs that meet: three ends, one junction."""
    return skin(Y_LIMBS, count, seed)


def two_bars(count: int = 2000, seed: int = 0) -> FloatArray:
    """Return two bars side by side: two pieces, two ends each."""
    return skin(TWO_BARS, count, seed)


def cylinder(count: int = 1000, seed: int = 0) -> FloatArray:
    """Return a round rod along x: one line."""
    return skin((Cone((-1, 0, 0), (1, 0, 0), (0.15, 0.15)),), count, seed)


def ball(count: int = 1000, seed: int = 0) -> FloatArray:
    """Return a sphere of radius 1."""
    return directions(count, np.random.default_rng(seed))


def turned(seed: int = 0) -> FloatArray:
    """Return a (3, 3) rotation without a preferred axis."""
    basis = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return np.asarray(basis * np.sign(np.linalg.det(basis)))
