"""Bridges over holes: cut ends are joined to each other, or to the limb that they aim at."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.ends import End
from mdcs_pipeline.kernels.joining import joined_pieces, places_on
from mdcs_pipeline.kernels.shore import Shore, straightness
from mdcs_pipeline.kernels.spanning import piece_labels

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Taken off the sum of two cosines: alignment then counts for more than a shorter bridge does.
_SLACK = 0.5


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
    onward : float
        Mean cosine of two ends' courses and their bridge from which one limb goes on over it;
        of those that meet at a sharper angle each may still join another piece.
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
    onward: float = 0.85


def bridges(pairs: IntArray, ends: list[End], shore: Shore, rule: BridgeRule) -> IntArray:
    """Return edges that join open ends to each other, or to what they aim at.

    Two ends are joined when each lies on the course of the other, best first, each end once. An
    open one that is left over is joined to an end that it faces, taken or not: where a junction
    of three limbs is missing; to any node, or edge of another piece, that it aims at: where a
    limb was cut off at its root; or to a bridge that it aims at: where all of a T is missing. No
    bridge leads through the surface, so that both its ends are open to it. Bridges that cross are
    tied together: where a crossing is missing. Pieces that are left are joined from their open
    ends.

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
            ahead = _ahead(end, opened, shore, joined, rule)
            if ahead is None:
                ahead = _across(end, built, shore, rule)
            if ahead is not None:
                built.append((end.node, ahead))
    radius = {end.node: end.radius for end in ends}
    built += _ties(built, shore.nodes, radius)
    return np.concatenate([_as_pairs(built), _joined(pairs, built, ends, shore, rule)])


def _joined(
    pairs: IntArray, built: list[tuple[int, int]], ends: list[End], shore: Shore, rule: BridgeRule
) -> IntArray:
    """Return edges between the pieces that bridges have left."""
    by_node = {end.node: end for end in ends}
    opened = [end for end in ends if end.openness >= rule.openness]
    missing = [_missing(end, built, by_node, rule.onward) for end in opened]
    left = [end for end in missing if end is not None]
    together = np.concatenate([pairs, _as_pairs(built)])
    more = joined_pieces(together, left, shore, rule.reach, rule.aim, rule.crowd)
    return np.sort(more, axis=1)


def _missing(
    end: End, built: list[tuple[int, int]], by_node: dict[int, End], onward: float
) -> End | None:
    """Return an open end as it looks at what is missing yet, None where nothing is.

    A limb that goes on over its bridge asks for no more, nor does an end that was joined to
    what it aims at. Where two ends have met at an angle, what both stood on may be missing.
    """
    partners = [a + b - end.node for a, b in built if end.node in (a, b)]
    if not partners:
        return end
    if any(node not in by_node for node in partners):
        return None
    others = [by_node[node] for node in partners]
    if not end.outward.any():
        # A slice of a pipe with one bridge looks out at its other side.
        away = end.place - others[0].place
        return end._replace(outward=away / np.linalg.norm(away)) if len(others) == 1 else None
    for other in others:
        both = _on_course(end, other.place), _on_course(other, end.place)
        if (sum(both) / 2.0 if other.outward.any() else both[0]) >= onward:
            return None
    return end


def _as_pairs(built: list[tuple[int, int]]) -> IntArray:
    return np.sort(np.array(built, dtype=np.int64).reshape(-1, 2), axis=1)


def _on_course(end: End, goal: FloatArray) -> float:
    """Return how straight ahead, or how near to the circle of its limb, `goal` lies."""
    return max(straightness(end, goal), end.course.cosine(goal - end.place))


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
    end: End, opened: list[End], shore: Shore, pairs: IntArray, rule: BridgeRule
) -> int | None:
    """Return the node that a left-over end is joined to, or the nearer one of an edge, if any."""
    piece = piece_labels(len(shore.nodes), pairs)
    best, goal = np.inf, None
    # Flat ends close no loop, neither with each other nor with their own limb.
    rimmed = {e.node for e in opened if e.radius >= rule.girth_aim * shore.scale[e.node]}
    ends = {other.node: other for other in opened}
    places, stand = places_on(shore.nodes, pairs)
    length = np.linalg.norm(places - end.place, axis=1)
    # The rim of something thick is nearer than its axis.
    near = (length - shore.scale[stand] <= rule.reach * end.radius) & (stand != end.node)
    # Only what knows where it looks aims between nodes, and only at what closes no loop.
    inner = np.arange(len(places)) >= len(shore.nodes)
    near &= ~inner | (end.outward.any() & (piece[stand] != piece[end.node]))
    for k in np.flatnonzero(near).tolist():
        node, place = int(stand[k]), places[k]
        cosine = straightness(end, place)
        if cosine < rule.aim or length[k] / cosine >= best:
            continue
        faces = k in ends and straightness(ends[k], end.place) >= rule.facing
        straight = float(end.outward @ (place - end.place)) / length[k]
        flat = end.node not in rimmed or (node in ends and node not in rimmed)
        within = not flat and (faces or straight >= rule.aim_within)
        if not (within or piece[node] != piece[end.node]):
            continue
        if k in ends:
            wall = shore.pierced_between(end, ends[k], rule.crowd_aim)
        else:
            wall = shore.pierced(end, place, rule.crowd_aim)
        if not wall:
            best, goal = length[k] / cosine, node
    return goal


def _across(end: End, built: list[tuple[int, int]], shore: Shore, rule: BridgeRule) -> int | None:
    """Return the nearer end of the bridge that a left-over end aims at, if any."""
    best, goal = np.inf, None
    bridged = places_on(shore.nodes, np.array(built, dtype=np.int64).reshape(-1, 2))
    places, stand = (found[len(shore.nodes) :] for found in bridged)
    for place, node in zip(places, stand.tolist(), strict=True):
        length, cosine = float(np.linalg.norm(place - end.place)), straightness(end, place)
        if length > rule.reach * end.radius or cosine < rule.aim or length >= best * cosine:
            continue
        if not shore.pierced(end, place, rule.crowd):
            best, goal = length / cosine, node
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
