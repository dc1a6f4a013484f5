"""Clouds and transport problems of the speed benchmark."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.problem import Problem

Floats = NDArray[np.floating]
DATA = Path(os.environ.get("MDCS_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
ARMADILLO = DATA / "meshes" / "gel_armadillo.ply"
WOLF = DATA / "clouds" / "pcl_wolf.ply"
POINTS, NODES, EPSILON = 15_585, 1_558, 0.001


def mesh(path: Path = ARMADILLO) -> tuple[Floats, NDArray[np.int64]]:
    """Return vertices and triangles."""
    import open3d

    held = open3d.io.read_triangle_mesh(str(path))
    return np.asarray(held.vertices), np.asarray(held.triangles, dtype=np.int64)


def sampled(count: int, path: Path = ARMADILLO, seed: int = 0) -> Floats:
    """Return float32 points spread evenly over a mesh, a million at a time."""
    vertices, triangles = mesh(path)
    corners = vertices[triangles]
    sides = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.cumsum(np.linalg.norm(np.cross(*sides), axis=1))
    rng, points = np.random.default_rng(seed), np.empty((count, 3), np.float32)
    for start in range(0, count, 1_000_000):
        part = points[start : start + 1_000_000]
        face = np.searchsorted(area, rng.random(len(part)) * area[-1])
        a, b = rng.random((2, len(part), 1))
        folded = a + b > 1
        a, b = np.where(folded, 1 - a, a), np.where(folded, 1 - b, b)
        part[:] = corners[face, 0] + a * sides[0][face] + b * sides[1][face]
    return points


def repeated(points: Floats, times: int) -> Floats:
    """Return copies of an object on a square grid, one and a half of its widths apart."""
    side = int(np.ceil(np.sqrt(times)))
    step = 1.5 * np.ptp(points, axis=0)
    shifts = np.array([(k % side, k // side, 0) for k in range(times)]) * step
    return (points[None] + shifts[:, None]).reshape(-1, 3).astype(points.dtype)


def transport_problem(
    count: int = POINTS, nodes: int = NODES, epsilon: float = EPSILON, seed: int = 0
) -> Problem:
    """Return points of the armadillo, box diagonal 1, equal masses, random points as nodes."""
    points = sampled(count, seed=seed).astype(np.float64)
    points /= np.linalg.norm(np.ptp(points, axis=0))
    chosen = np.random.default_rng(seed).choice(count, nodes, replace=False)
    return Problem(
        points,
        np.full(count, 1 / count),
        points[chosen],
        np.full(nodes, 1 / nodes),
        epsilon,
        np.ones(count),
        np.ones(nodes),
    )
