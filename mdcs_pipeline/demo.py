"""A cloud to try the package on: the skin of a small four-legged animal, as a scanner sees it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Joints in metres (x forward, z up) with the radius of the body there. The pose is uneven on
# purpose: a symmetric one would hide a method that mirrors or averages.
_JOINTS: dict[str, tuple[float, float, float, float]] = {
    "rump": (-0.42, 0.00, 0.62, 0.145),
    "belly": (0.00, 0.01, 0.60, 0.155),
    "chest": (0.40, 0.00, 0.66, 0.150),
    "neck": (0.62, 0.03, 0.88, 0.080),
    "poll": (0.72, 0.05, 1.02, 0.085),
    "muzzle": (0.97, 0.10, 0.94, 0.045),
    "hip_l": (-0.44, 0.15, 0.52, 0.090),
    "hock_l": (-0.56, 0.17, 0.26, 0.055),
    "hoof_l": (-0.50, 0.18, 0.02, 0.042),
    "hip_r": (-0.42, -0.15, 0.52, 0.090),
    "hock_r": (-0.44, -0.17, 0.27, 0.055),
    "hoof_r": (-0.32, -0.18, 0.02, 0.042),
    "shoulder_l": (0.42, 0.14, 0.54, 0.085),
    "knee_l": (0.52, 0.16, 0.28, 0.050),
    "foot_l": (0.46, 0.17, 0.02, 0.040),
    "shoulder_r": (0.42, -0.14, 0.54, 0.085),
    "knee_r": (0.40, -0.16, 0.28, 0.050),
    "foot_r": (0.28, -0.17, 0.02, 0.040),
    "dock": (-0.62, 0.00, 0.72, 0.050),
    "tail": (-0.84, 0.06, 0.58, 0.042),
    "tuft": (-0.96, 0.12, 0.34, 0.036),
}
_BONES = (
    ("rump", "belly"),
    ("belly", "chest"),
    ("chest", "neck"),
    ("neck", "poll"),
    ("poll", "muzzle"),
    ("rump", "hip_l"),
    ("hip_l", "hock_l"),
    ("hock_l", "hoof_l"),
    ("rump", "hip_r"),
    ("hip_r", "hock_r"),
    ("hock_r", "hoof_r"),
    ("chest", "shoulder_l"),
    ("shoulder_l", "knee_l"),
    ("knee_l", "foot_l"),
    ("chest", "shoulder_r"),
    ("shoulder_r", "knee_r"),
    ("knee_r", "foot_r"),
    ("rump", "dock"),
    ("dock", "tail"),
    ("tail", "tuft"),
)
# A patch on the left flank that the scanner did not see.
_HOLE = (np.array([0.10, 0.17, 0.62]), 0.09)

#: Ends of the curve skeleton that the animal has: four feet, the muzzle, the tail.
DEMO_LEAVES = 6


def bones() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the round cones that the animal is made of.

    Returns
    -------
    ends : (20, 2, 3) float64
        Both ends of each axis, in metres.
    radii : (20, 2) float64
        The radius at each end, in metres.
    """
    both = np.array([[_JOINTS[name] for name in pair] for pair in _BONES])
    return both[..., :3], both[..., 3]


def _nearest_bone(
    points: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the depth below zero or height above the skin, and the bone's point and radius."""
    ends, radii = bones()
    height = np.full(len(points), np.inf)
    foot = np.empty_like(points)
    radius = np.empty(len(points))
    for (start, stop), (first, last) in zip(ends, radii, strict=True):
        axis = stop - start
        t = np.clip((points - start) @ axis / (axis @ axis), 0.0, 1.0)
        on_axis = start + t[:, None] * axis
        wide = first + t * (last - first)
        above = np.linalg.norm(points - on_axis, axis=1) - wide
        nearer = above < height
        height[nearer], foot[nearer], radius[nearer] = above[nearer], on_axis[nearer], wide[nearer]
    return height, foot, radius


def skin_height(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far (N, 3) points lie above the animal's skin, in metres; below it negative."""
    return _nearest_bone(points)[0]


def _skin(count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return `count` points spread evenly over the skin of all bones together.

    Points drawn in a thin layer over the skin and pulled down onto it: where bones meet,
    what lies inside another bone is never drawn.
    """
    layer = 0.012
    ends, radii = bones()
    low = (ends - radii[..., None]).min(axis=(0, 1)) - layer
    high = (ends + radii[..., None]).max(axis=(0, 1)) + layer
    found: list[NDArray[np.float64]] = []
    while sum(map(len, found)) < count:
        drawn = rng.uniform(low, high, size=(20 * count, 3))
        height, foot, radius = _nearest_bone(drawn)
        near = (height > 0) & (height < layer)
        out = drawn[near] - foot[near]
        out *= (radius[near] / np.linalg.norm(out, axis=1))[:, None]
        found.append(foot[near] + out)
    return np.concatenate(found)[:count]


def demo_cloud(count: int = 6000, noise: float = 0.002, seed: int = 0) -> NDArray[np.float64]:
    """Return a scan of the animal: its skin with noise, and a hole in the left flank.

    Parameters
    ----------
    count : int
        Points before the hole is cut out; about 1 % are lost to it.
    noise : float
        Standard deviation of each coordinate, in metres; the animal is 2 m long.
    seed : int
        The same seed gives the same cloud.

    Returns
    -------
    (N, 3) float64
        Points in metres, z up.
    """
    rng = np.random.default_rng(seed)
    points = _skin(count, rng)
    points = points + rng.normal(0.0, noise, points.shape)
    centre, reach = _HOLE
    seen: NDArray[np.float64] = points[np.linalg.norm(points - centre, axis=1) > reach]
    return seen
