"""Bridges over holes: cut ends are joined to each other, or to the limb that they aim at."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mdcs_pipeline.kernels.courses import smooth_way
from mdcs_pipeline.kernels.ends import End
from mdcs_pipeline.kernels.spanning import piece_labels

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Taken off the sum of two cosines: alignment then counts for more than a shorter bridge does.
_SLACK = 0.5
# Where a bridge is looked at as something to aim at: not at its ends.
_BETWEEN = (0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875)


class BridgeRule(NamedTuple):
    """What is bridged.

    Parameters
    ----------
    openness : float
        Least openness of an end, for two that face each other the mean of both.
    reach : float
        Longest bridge, in the larger radius of its ends.
    facing : float
        Least cosine between an end's course and the bridge, for two open ends.
    aim : float
        The same for an open end that meets a node of another piece.
    aim_within : float
        The same for a node of its own piece: it closes a loop.
    ratio : float
        Largest ratio of the two ends' radii.
    girth : float
        Least radius of two ends that face each other, in the local radius at their nodes: a rim
        goes around its limb, and a flat hand, whose fingers look like a rim, does not.
    girth_aim : float
        The same for an end that aims at its own piece.
    crowd : float
        A bridge between two ends that has more points than this around it, in those of its end,
        leads through the surface. One that is pierced brings about 0.08.
    crowd_aim : float
        The same for an end that aims at something that does not face it.
    """

    openness: float = 0.15
    reach: float = 10.0
    facing: float = 0.3
    aim: float = 0.5
    aim_within: float = 0.75
    ratio: float = 3.0
    girth: float = 0.6
    girth_aim: float = 0.5
    crowd: float = 0.06
    crowd_aim: float = 0.03


class Shore(NamedTuple):
    """The cloud around the ends.

    Parameters
    ----------
    nodes : (m, 3) float64
    scale : (m,) float64
        Local radius.
    points : (n, 3) float64
    held : (m,) int64
        Points of each node.
    tree : cKDTree
        Of the points.
    """

    nodes: FloatArray
    scale: FloatArray
    points: FloatArray
    held: IntArray
    tree: cKDTree

    @classmethod
    def around(
        cls, nodes: FloatArray, scale: FloatArray, points: FloatArray, owner: IntArray
    ) -> Shore:
        """Return the cloud with the node of each point, (n,)."""
        held = np.bincount(owner, minlength=len(nodes))
        return cls(nodes, scale, points, held, cKDTree(points))

    def walled(self, a: End, b: End, crowd: float) -> bool:
        """Return whether the straight and the bent way between two ends both pierce the surface."""
        if not (self.pierced(a, b.place, crowd) or self.pierced(b, a.place, crowd)):
            return False
        way = smooth_way(a.place, a.outward, b.place, b.outward)
        # What is farther than any end counts is not looked at: the scene may be large.
        around = self.within(way, 0.5 * max(a.radius, b.radius))
        distance, nearest = (np.asarray(found) for found in cKDTree(way).query(around))
        between = (nearest > 0) & (nearest < len(way) - 1)
        return any(self._crowded(distance[between], end, crowd) for end in (a, b))

    def within(self, places: FloatArray, reach: float) -> FloatArray:
        """Return the points within reach of any of some places, (k, 3)."""
        near = self.tree.query_ball_point(places, reach)
        return self.points[np.unique(np.concatenate([*near, []]).astype(np.int64))]

    def _crowded(self, distance: FloatArray, end: End, crowd: float) -> bool:
        near = np.count_nonzero(distance < 0.5 * end.radius)
        return bool(near > crowd * self.held[end.node])

    def pierced(self, end: End, goal: FloatArray, crowd: float) -> bool:
        """Return whether the way from an end to `goal` leads through the surface.

        Both lie inside the shape. Only through holes does a straight way lead from one to the
        other without points around it.
        """
        way = goal - end.place
        length = float(np.linalg.norm(way))
        reach = max(0.5 * end.radius, 1e-3 * length)
        steps = np.linspace(0.0, 1.0, 2 + int(length / reach))
        # Between two steps a point within reach of the way is that far from one of them.
        around = self.within(end.place + np.outer(steps, way), 1.2 * reach)
        offset = around - end.place
        along = offset @ way / length
        between = (along > 0) & (along < length)
        across = np.linalg.norm(offset[between] - np.outer(along[between] / length, way), axis=1)
        return self._crowded(across, end, crowd)


def bridges(pairs: IntArray, ends: list[End], shore: Shore, rule: BridgeRule) -> IntArray:
    """Return edges that join open ends to each other, or to what they aim at.

    Two ends are joined when each lies on the course of the other, best first, each end once. An
    open one that is left over is joined to an end that it faces, taken or not: where a junction
    of three limbs is missing; to any node that it aims at: where a limb was cut off at its root;
    or to a bridge that it aims at: where all of a T is missing. No bridge leads through the
    surface, so that both its ends are open to it. Bridges that cross are tied together: where a
    crossing is missing.

    Parameters
    ----------
    pairs : (E, 2) int64
    ends : list of End
    shore : Shore
    rule : BridgeRule

    Returns
    -------
    (B, 2) int64
    """
    built: list[tuple[int, int]] = []
    # A slice of a pipe is open at both sides.
    free = {end.node: 1 if end.outward.any() else 2 for end in ends}
    for _, a, b in sorted(_facing(ends, shore, rule)):
        if free[a] > 0 and free[b] > 0:
            free[a] -= 1
            free[b] -= 1
            built.append((a, b))
    opened = [end for end in ends if end.openness >= rule.openness]
    for end in opened:
        if free[end.node] > 0 and not any(end.node in pair for pair in built):
            joined = np.concatenate([pairs, _as_pairs(built)])
            ahead = _ahead(end, opened, shore, piece_labels(len(shore.nodes), joined), rule)
            if ahead is None:
                ahead = _across(end, built, shore, rule)
            if ahead is not None:
                built.append((end.node, ahead))
    radius = {end.node: end.radius for end in ends}
    return _as_pairs(built + _ties(built, shore.nodes, radius))


def _as_pairs(built: list[tuple[int, int]]) -> IntArray:
    return np.sort(np.array(built, dtype=np.int64).reshape(-1, 2), axis=1)


def _cosine(end: End, goal: FloatArray) -> float:
    """Return how straight ahead of an end `goal` lies; an end without direction looks anywhere."""
    gap = goal - end.place
    length = float(np.linalg.norm(gap))
    if length == 0.0 or not end.outward.any():
        return 0.7
    straight = float(end.outward @ gap) / length
    return max(straight, float(end.rimward @ gap) / length) if straight > -0.2 else straight


def _on_course(end: End, goal: FloatArray) -> float:
    """Return how straight ahead, or how near to the circle of its limb, `goal` lies."""
    return max(_cosine(end, goal), end.course.cosine(goal - end.place))


def _facing(ends: list[End], shore: Shore, rule: BridgeRule) -> list[tuple[float, int, int]]:
    """Return (length in radii over alignment, node, node) of the ends that face each other."""
    found = []
    thick = [end for end in ends if end.radius >= rule.girth * shore.scale[end.node]]
    for k, a in enumerate(thick):
        for b in thick[k + 1 :]:
            length = float(np.linalg.norm(b.place - a.place))
            large, small = max(a.radius, b.radius), min(a.radius, b.radius)
            openness = 0.5 * (min(a.openness, 1.0) + min(b.openness, 1.0))
            if length == 0.0 or length > rule.reach * large or large > rule.ratio * small:
                continue
            ahead = _on_course(a, b.place), _on_course(b, a.place)
            if min(ahead) < rule.facing or openness < rule.openness:
                continue
            if not shore.walled(a, b, rule.crowd):
                alignment = max(sum(ahead) - _SLACK, 0.1)
                found.append((length / large / alignment, a.node, b.node))
    return found


def _ahead(
    end: End, opened: list[End], shore: Shore, piece: IntArray, rule: BridgeRule
) -> int | None:
    """Return the node that a left-over end is joined to, if any."""
    best, goal = np.inf, None
    # Flat ends close no loop, neither with each other nor with their own limb.
    rimmed = {e.node for e in opened if e.radius >= rule.girth_aim * shore.scale[e.node]}
    ends = {other.node: other for other in opened}
    length = np.linalg.norm(shore.nodes - end.place, axis=1)
    # The rim of something thick is nearer than its axis.
    near = (length - shore.scale <= rule.reach * end.radius) & (length > 0)
    for node in np.flatnonzero(near).tolist():
        cosine = _cosine(end, shore.nodes[node])
        if cosine < rule.aim or length[node] / cosine >= best:
            continue
        faces = node in ends and _cosine(ends[node], end.place) >= rule.facing
        straight = float(end.outward @ (shore.nodes[node] - end.place)) / length[node]
        flat = end.node not in rimmed or (node in ends and node not in rimmed)
        within = not flat and (faces or straight >= rule.aim_within)
        if (within or piece[node] != piece[end.node]) and not shore.pierced(
            end, shore.nodes[node], rule.crowd_aim
        ):
            best, goal = length[node] / cosine, node
    return goal


def _across(end: End, built: list[tuple[int, int]], shore: Shore, rule: BridgeRule) -> int | None:
    """Return the nearer end of the bridge that a left-over end aims at, if any."""
    best, goal = np.inf, None
    for a, b in built:
        for t in _BETWEEN:
            place = (1.0 - t) * shore.nodes[a] + t * shore.nodes[b]
            length, cosine = float(np.linalg.norm(place - end.place)), _cosine(end, place)
            if length > rule.reach * end.radius or cosine < rule.aim or length >= best * cosine:
                continue
            if not shore.pierced(end, place, rule.crowd):
                best, goal = length / cosine, a if t < 0.5 else b
    return goal


def _ties(
    built: list[tuple[int, int]], nodes: FloatArray, radius: dict[int, float]
) -> list[tuple[int, int]]:
    """Return an edge between the nearest ends of each two bridges that cross."""
    ties = []
    steps = np.linspace(0.0, 1.0, 17)[:, None]
    for k, (a, b) in enumerate(built):
        for c, d in built[k + 1 :]:
            if {a, b} & {c, d}:
                continue
            one = nodes[a] + steps * (nodes[b] - nodes[a])
            other = nodes[c] + steps * (nodes[d] - nodes[c])
            apart = np.linalg.norm(one[:, None] - other[None], axis=2).min()
            if apart < min(radius[a], radius[c]):
                options = [(a, c), (a, d), (b, c), (b, d)]
                ties.append(
                    min(options, key=lambda e: float(np.linalg.norm(nodes[e[0]] - nodes[e[1]])))
                )
    return ties
