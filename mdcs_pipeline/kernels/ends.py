"""Ends of a skeleton's limbs: where they point, how thick they are, whether they are cut open.

A limb that ends is capped: the surface goes all around its tip. A limb that a hole has cut ends
in a rim, beyond which there is no surface.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.courses import Course, course_of
from mdcs_pipeline.kernels.cycles import neighbour_sets

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# Share of the points beyond each end of a stretch: they are noise.
_TAIL = 0.03
# Stretch of a limb that tells how it bends, in radii: longer than the noise of its nodes.
_BEHIND = 6.0
# Places that lie nearer than this to a line, in their radius, are its axis.
_ON_LINE = 0.35


class End(NamedTuple):
    """A leaf of a skeleton, or a node on its own.

    Parameters
    ----------
    node : int
    place : (3,) float64
    outward : (3,) float64
        Unit vector along the limb, away from it; 0 for a node on its own.
    radius : float
        Median distance of the limb's last points from its axis.
    openness : float
        Share of its outermost points that lie on a rim.
    extent : float
        How far beyond the node its limb's points reach.
    rimward : (3,) float64
        Unit vector to the middle of its rim, 0 without one: where a corner is missing it differs
        from the limb's direction.
    course : Course
        How the limb goes on, as it has bent before its end; straight on where no rims are known.
    """

    node: int
    place: FloatArray
    outward: FloatArray
    radius: float
    openness: float
    extent: float
    rimward: FloatArray
    course: Course


def _limb(near: list[set[int]], leaf: int, nodes: FloatArray, length: float) -> list[int]:
    """Return the nodes of the chain behind a leaf, up to a junction or `length`."""
    chain = [leaf, *near[leaf]]
    while len(near[chain[-1]]) == 2 and np.linalg.norm(nodes[chain[-1]] - nodes[leaf]) < length:
        (following,) = near[chain[-1]] - {chain[-2]}
        chain.append(following)
    return chain


def limb_ends(
    nodes: FloatArray,
    scale: FloatArray,
    pairs: IntArray,
    points: FloatArray,
    owner: IntArray,
    rim: BoolArray | None = None,
    but: BoolArray | None = None,
) -> list[End]:
    """Return the leaves of a graph with their direction, radius and openness.

    Parameters
    ----------
    nodes : (m, 3) float64
    scale : (m,) float64
        Local radius.
    pairs : (E, 2) int64
    points : (n, 3) float64
    owner : (n,) int64
        Node of each point.
    rim : (n,) bool, optional
        Points on a rim. With them, nodes on their own count as ends too.
    but : (m,) bool, optional
        Nodes whose ends are not asked for.

    Returns
    -------
    list of End
    """
    near = neighbour_sets(len(nodes), pairs)
    ends = []
    for node, partners in enumerate(near):
        if but is not None and but[node]:
            continue
        if len(partners) == 1:
            chain = _limb(near, node, nodes, 2.0 * float(scale[node]))
            outward = nodes[node] - nodes[chain[-1]]
            length = float(np.linalg.norm(outward))
            mine = np.flatnonzero((owner == chain[0]) | (owner == chain[1]))
            if length > 0.0 and len(mine) >= 4:
                course = Course(outward / length, np.zeros(3))
                if rim is not None:
                    behind = _limb(near, node, nodes, _BEHIND * float(scale[node]))
                    course = course_of(nodes[behind])
                ends.append(_end(node, nodes[node], outward / length, course, points, mine, rim))
        elif not partners and rim is not None:
            mine = np.flatnonzero(owner == node)
            if len(mine) >= 4:
                ends.append(_lone(node, nodes[node], points[mine], rim[mine]))
    return ends


def _end(
    node: int,
    place: FloatArray,
    outward: FloatArray,
    course: Course,
    points: FloatArray,
    mine: IntArray,
    rim: BoolArray | None,
) -> End:
    offset = points[mine] - place
    along = offset @ outward
    across = np.linalg.norm(offset - along[:, None] * outward, axis=1)
    radius = float(np.median(across))
    extent = float(np.quantile(along, 0.97))
    outermost = along > extent - 0.7 * radius
    openness = 0.0 if rim is None else float(np.mean(rim[mine[outermost]]))
    rimward = np.zeros(3)
    if rim is not None:
        rimward = _towards(offset[rim[mine] & (along > 0.1 * radius)], 0.25 * radius)
    return End(node, place, outward, radius, openness, extent, rimward, course)


def _towards(offset: FloatArray, least: float) -> FloatArray:
    """Return the unit vector to the middle of some points, 0 where that is hardly anywhere."""
    middle = offset.mean(axis=0) if len(offset) >= 3 else np.zeros(3)
    length = float(np.linalg.norm(middle))
    return np.asarray(middle / length if length > least else 0.0 * middle, dtype=np.float64)


def _lone(node: int, place: FloatArray, points: FloatArray, rim: BoolArray) -> End:
    distance = np.linalg.norm(points - place, axis=1)
    # A slice of a pipe is outermost at both sides: about half of its points are.
    radius, openness = float(np.median(distance)), 2.0 * float(np.mean(rim))
    nowhere = np.zeros(3)
    return End(node, place, nowhere, radius, openness, 0.0, nowhere, Course(nowhere, nowhere))


def stretched(nodes: FloatArray, ends: list[End]) -> FloatArray:
    """Return the nodes with each end moved out to the centre of its limb's round tip.

    A node at the end of a limb carries the limb's last stretch, and stands in the middle of
    it. The medial axis goes on, to one radius before the tip.

    Parameters
    ----------
    nodes : (m, 3) float64
    ends : list of End

    Returns
    -------
    (m, 3) float64
    """
    moved = nodes.copy()
    for end in ends:
        moved[end.node] += max(0.0, end.extent - end.radius) * end.outward
    return moved


class Segment(NamedTuple):
    """The stretch of medial axis that a node on its own stands for.

    Parameters
    ----------
    node : int
    tips : (2, 3) float64
        Centres of its round ends.
    """

    node: int
    tips: FloatArray


def lone_segments(
    nodes: FloatArray,
    pairs: IntArray,
    points: FloatArray,
    owner: IntArray,
    places: FloatArray,
    least: float = 0.5,
) -> list[Segment]:
    """Return the nodes without edges whose points make more than a ball, as segments.

    The points of an egg reach farther along it than across. Its medial axis is the segment
    between the centres of its tips: as far as the points' medial places reach, where these lie
    on a line; otherwise it ends one radius before the points do.

    Parameters
    ----------
    nodes : (m, 3) float64
    pairs : (E, 2) int64
    points : (n, 3) float64
    owner : (n,) int64
        Node of each point.
    places : (n, 3) float64
        Medial places of the points; the points themselves where none are known.
    least : float
        Shortest segment, in radii: below that the points make a ball.

    Returns
    -------
    list of Segment
    """
    linked = np.isin(np.arange(len(nodes)), pairs)
    segments = []
    for node in np.flatnonzero(~linked).tolist():
        mine = owner == node
        if np.count_nonzero(mine) < 4:
            continue
        stretch = _seen_from_inside(points[mine], places[mine])
        if stretch is None:
            stretch = _seen_from_outside(points[mine] - nodes[node], nodes[node])
        tips, radius = stretch
        if np.linalg.norm(tips[1] - tips[0]) > least * radius:
            segments.append(Segment(node, tips))
    return segments


def _seen_from_inside(points: FloatArray, places: FloatArray) -> tuple[FloatArray, float] | None:
    """Return the stretch that medial places lie on, and its radius; None where they do not."""
    middle = np.median(places, axis=0)
    values, axes = np.linalg.eigh((places - middle).T @ (places - middle) / len(places))
    radius = float(np.median(np.linalg.norm(points - places, axis=1)))
    if np.sqrt(max(values[0] + values[1], 0.0)) >= _ON_LINE * radius:
        return None
    along = np.quantile((places - middle) @ axes[:, 2], [_TAIL, 1.0 - _TAIL])
    return middle + np.outer(along, axes[:, 2]), radius


def _seen_from_outside(offset: FloatArray, node: FloatArray) -> tuple[FloatArray, float]:
    """Return the stretch from one radius after the points' begin to one before their end."""
    _, axes = np.linalg.eigh(offset.T @ offset)
    along = offset @ axes[:, 2]
    across = np.linalg.norm(offset - np.outer(along, axes[:, 2]), axis=1)
    # Across the middle half: the tips are round.
    middle = np.abs(along - np.median(along)) <= np.median(np.abs(along - np.median(along)))
    radius = float(np.median(across[middle]))
    low, high = np.quantile(along, [_TAIL, 1.0 - _TAIL]) + np.array([radius, -radius])
    return node + np.outer([low, max(low, high)], axes[:, 2]), radius
