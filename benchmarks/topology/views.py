"""Simulated depth cameras: what they see of a solid, and how densely."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benchmarks.topology.solid import Floats, Sample, Shape, hidden, join, sample

Left = Callable[[Sample, NDArray[np.bool_]], float]
# A surface seen at a steeper angle than this (80 degrees) returns no depth.
GRAZING = 0.17
DRAWS = 25


def cameras(shape: Shape, count: int, rng: np.random.Generator) -> Floats:
    """Return `count` camera places (count, 3) evenly around a random axis, 1.5 diagonals away."""
    axis, start = rng.normal(size=(2, 3))
    axis /= np.linalg.norm(axis)
    start -= (start @ axis) * axis
    start /= np.linalg.norm(start)
    other = np.cross(axis, start)
    # Cameras in one plane and exactly opposite each other would be a special case.
    angle = 2 * np.pi * np.arange(count) / count + rng.uniform(-0.25, 0.25, count)
    rise = rng.uniform(-0.3, 0.3, count)
    away = np.cos(angle)[:, None] * start + np.sin(angle)[:, None] * other + rise[:, None] * axis
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    low, high = shape.box
    return (low + high) / 2 + 1.5 * shape.diagonal * away


def facing(cloud: Sample, camera: Floats) -> Floats:
    """Return the cosine (N,) between each normal and the way to the camera."""
    rays = camera - cloud.points
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return np.einsum("ij,ij->i", cloud.normals, rays)


def seen_by(shape: Shape, cloud: Sample, camera: Floats) -> NDArray[np.bool_]:
    """Return which surface points a camera sees: facing it, and not behind the solid."""
    seen = facing(cloud, camera) > GRAZING
    front = np.flatnonzero(seen)
    seen[front] = ~hidden(shape, cloud.points[front], camera)
    return seen


def _best_cameras(
    shape: Shape, count: int, rng: np.random.Generator, left: Left, least: float
) -> Floats:
    """Return the first cameras that leave `least` of every branch, or the best of all draws."""
    trial = sample(shape, 1500, rng)
    best, best_left = np.zeros((count, 3)), -1.0
    for _ in range(DRAWS):
        places = cameras(shape, count, rng)
        seen = np.logical_or.reduce([seen_by(shape, trial, place) for place in places])
        share = left(trial, seen)
        if share > best_left:
            best, best_left = places, share
        if share >= least:
            break
    return best


def depth_views(
    shape: Shape, n: int, rng: np.random.Generator, count: int, left: Left, least: float
) -> list[Sample]:
    """Return what each of `count` cameras sees, `n` points in all.

    The pixels of a depth image are even, so points on the surface thin out with the cosine of the
    angle and with the square of the distance.
    """
    places = _best_cameras(shape, count, rng, left, least)
    wanted = [n // count + (k < n % count) for k in range(count)]
    views = []
    for place, want in zip(places, wanted, strict=True):
        parts: list[Sample] = []
        while sum(map(len, parts)) < want:
            pool = sample(shape, 3 * n // 2, rng)
            distance = np.linalg.norm(place - pool.points, axis=1)
            chance = np.clip(facing(pool, place), 0, 1) * (distance.min() / distance) ** 2
            pool = pool.take(rng.random(len(pool)) < chance)
            parts.append(pool.take(seen_by(shape, pool, place)))
        views.append(join(parts).take(np.arange(want)))
    return views
