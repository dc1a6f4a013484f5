"""The course of a limb past its end: straight on, or along the circle that it has followed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# Cubic pieces of a way: a few to each radius of the longest bridge.
_STEPS = 24
# Least cosine between a way and its ends' directions that its handles answer to.
_BACKWARD = -0.6


class Course(NamedTuple):
    """How a limb goes on.

    Parameters
    ----------
    tangent : (3,) float64
        Unit vector in which the limb leaves its end; 0 where nothing tells it.
    bend : (3,) float64
        Curvature, towards the middle of the circle; 0 for a straight limb.
    """

    tangent: FloatArray
    bend: FloatArray

    def cosine(self, gap: FloatArray) -> float:
        """Return how near to the limb's course the end of `gap` lies, as a cosine.

        A chord of length L leaves a circle of curvature κ at an angle of asin(κL/2) from the
        tangent: ends of one circle see each other at 1, however far it has turned.
        """
        length, curvature = float(np.linalg.norm(gap)), float(np.linalg.norm(self.bend))
        if length == 0.0:
            return 0.0
        sine = min(1.0, 0.5 * curvature * length)
        chord = np.sqrt(1.0 - sine * sine) * self.tangent
        if curvature > 0.0:
            chord = chord + sine * self.bend / curvature
        return float(chord @ gap) / length


def course_of(chain: FloatArray) -> Course:
    """Return the course of the circle through the first, middle and last node of a chain.

    Parameters
    ----------
    chain : (k, 3) float64
        Nodes from the end backwards.
    """
    end, start = chain[0], chain[-1]
    straight, middle = end - start, chain[len(chain) // 2]
    length = float(np.linalg.norm(straight))
    if len(chain) < 3 or length == 0.0:
        return Course(straight / (length or 1.0), np.zeros(3))
    u, v = end - middle, start - middle
    normal = np.cross(u, v)
    square = float(normal @ normal)
    if square <= 1e-12 * float(u @ u) * float(v @ v):
        return Course(straight / length, np.zeros(3))
    to_centre = (u @ u * np.cross(v, normal) + v @ v * np.cross(normal, u)) / (2.0 * square) - u
    radius = float(np.linalg.norm(to_centre))
    tangent = np.cross(np.cross(to_centre, straight), to_centre)
    return Course(tangent / np.linalg.norm(tangent), to_centre / radius**2)


def smooth_way(
    start: FloatArray, leaving: FloatArray, goal: FloatArray, arriving: FloatArray
) -> FloatArray:
    """Return points of the cubic from `start` to `goal` that leaves both along their directions.

    Where both directions belong to one circle it is that circle, to a thousandth of its
    radius over a quarter turn and a fiftieth over half a turn: a handle is 2L / 3(1 + cos φ) long
    for a chord of length L at an angle of φ from the tangent.

    Parameters
    ----------
    start, goal : (3,) float64
    leaving, arriving : (3,) float64
        Unit vectors out of the two limbs; 0 for one that looks anywhere.

    Returns
    -------
    (25, 3) float64
    """
    gap = goal - start
    first = start + _handle(leaving, gap)
    last = goal + _handle(arriving, -gap)
    t = np.linspace(0.0, 1.0, _STEPS + 1)[:, None]
    s = 1.0 - t
    way = s**3 * start + 3.0 * s * s * t * first + 3.0 * s * t * t * last + t**3 * goal
    return np.asarray(way, dtype=np.float64)


def _handle(direction: FloatArray, gap: FloatArray) -> FloatArray:
    length = float(np.linalg.norm(gap))
    if not direction.any():
        direction = gap / length
    cosine = max(_BACKWARD, float(direction @ gap) / length)
    return direction * (2.0 * length / (3.0 * (1.0 + cosine)))
