"""Depth frames of a shape, as a range camera on a path around it sees it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.topology.solid import Floats, Shape


def _tube(a: Floats, b: Floats, ra: float, rb: float, sides: int = 24) -> tuple[Floats, Any]:
    """Return the side of a truncated cone as vertices and triangles."""
    axis = (b - a) / np.linalg.norm(b - a)
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    other = np.cross(axis, across)
    angle = np.arange(sides) * 2 * np.pi / sides
    ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * other
    k, n = np.arange(sides), (np.arange(sides) + 1) % sides
    faces = np.concatenate(
        [np.stack([k, n, sides + k], axis=1), np.stack([n, sides + n, sides + k], axis=1)]
    )
    return np.concatenate([a + ra * ring, b + rb * ring]), faces


def parts_of(shape: Shape) -> list[tuple[Floats, Any]]:
    """Return the vertices and triangles of a ball for each node and a cone for each edge."""
    import open3d as o3d

    ball = o3d.geometry.TriangleMesh.create_sphere(1.0, resolution=20)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.triangles)
    balls = [(p + r * vertices, faces) for p, r in zip(shape.nodes, shape.balls, strict=True)]
    ends = (
        (shape.nodes[i], shape.nodes[j], shape.balls[i], shape.balls[j]) for i, j in shape.edges
    )
    return balls + [_tube(*end) for end in ends]


class Camera:
    """Casts rays at triangles whose parts may overlap: the first hit is the outer surface.

    Parameters
    ----------
    parts : list of (vertices, triangles)
    noise : float
        Standard deviation along the ray, in input units.
    seed : int
    """

    def __init__(self, parts: list[tuple[Floats, Any]], noise: float = 0.0, seed: int = 0) -> None:
        import open3d as o3d

        self._o3d = o3d
        self._noise = noise
        self._rng = np.random.default_rng(seed)
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        for vertices, faces in parts:
            self._add(vertices, faces)

    def _add(self, vertices: Floats, faces: Any) -> None:
        core = self._o3d.core
        self._scene.add_triangles(
            core.Tensor(vertices.astype(np.float32)), core.Tensor(faces.astype(np.uint32))
        )

    def frame(
        self, eye: Floats, target: Floats, points: int, angle: float = 42.0, width: int = 120
    ) -> Floats:
        """Return about `points` points of one frame, in the scene's frame.

        A coarse look tells how much of the image the shape fills.
        """
        seen = len(self._cast(eye, target, width, angle))
        return self._cast(eye, target, round(width * np.sqrt(points / max(seen, 1))), angle)

    def _cast(self, eye: Floats, target: Floats, width: int, angle: float) -> Floats:
        up = np.array([0.0, 0.0, 1.0])
        if abs(np.dot(target - eye, up)) > 0.99 * np.linalg.norm(target - eye):
            up = np.array([0.0, 1.0, 0.0])
        rays = self._scene.create_rays_pinhole(
            fov_deg=angle, center=target.tolist(), eye=eye.tolist(), up=up.tolist(),
            width_px=width, height_px=width,
        )  # fmt: skip
        depth = self._scene.cast_rays(rays)["t_hit"].numpy().ravel()
        flat = rays.numpy().reshape(-1, 6).astype(np.float64)
        hit = np.isfinite(depth)
        step = flat[hit, 3:]
        step /= np.linalg.norm(step, axis=1, keepdims=True)
        # Rays of a pinhole are not of unit length; the hit is at t times the ray.
        places = flat[hit, :3] + depth[hit, None] * flat[hit, 3:]
        return places + self._rng.normal(0.0, self._noise, (int(hit.sum()), 1)) * step


def orbit(
    box: tuple[Floats, Floats], frames: int, laps: float = 1.0, lift: float = 0.35
) -> Iterator[tuple[Floats, Floats]]:
    """Yield eye and target of a camera that circles a box, up and down as it goes."""
    low, high = box
    centre, diagonal = (low + high) / 2, float(np.linalg.norm(high - low))
    for k in range(frames):
        turn = 2 * np.pi * laps * k / frames
        height = lift * np.sin(2.0 * turn + 0.5)
        aim = np.array([np.cos(turn), np.sin(turn), height])
        yield centre + 1.5 * diagonal * aim / np.linalg.norm(aim), centre
