"""Ties: edges between two limbs that leave nothing for the tie to explain.

Where noise hides the surface, a few points that went to the wrong limb are enough for a link. Of
an edge on its own little can be said; of all edges together transport can tell: points go to
blurred tubes along the edges (see `limbs`), with free masses, and a limb's edges keep as much mass
per length and radius as other limbs' do. Points around a tie are explained by the limbs that it
ties, and it keeps next to nothing.

So does an edge that leads from a limb's axis to the first node of what branches off there: it lies
within the limb. But that one goes on; a tie has a junction at both its ends.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.limbs import BLUR, Pieces, blurred_tubes, explained_mass
from mdcs_pipeline.kernels.spanning import piece_labels

__all__ = ["TieRule", "untied"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Longest piece of an edge, and its standard deviation along it, in radii.
_PIECE = 0.4
# Turns of transport, and those after a tie is gone: its mass moves to its neighbours.
_TURNS, _AGAIN = 60, 20


class TieRule(NamedTuple):
    """Which edges are ties.

    Parameters
    ----------
    loop : float
        Mass per length and radius, in the median edge's, below which an edge on a loop is one.
    between : float
        The same for the only edge between two pieces, which are apart without it.
    through : float
        Least cosine between the two ways of the limb that goes on at each end of a tie.
    """

    loop: float = 0.4
    between: float = 0.05
    through: float = 0.5


def untied(
    points: FloatArray,
    mass: FloatArray,
    nodes: FloatArray,
    radius: FloatArray,
    edges: IntArray,
    rule: TieRule,
) -> IntArray:
    """Return the edges without ties, which go one by one, the weakest first.

    Parameters
    ----------
    points : (n, 3) float64
        As they were measured: with the noise.
    mass : (n,) float64
    nodes : (m, 3) float64
    radius : (m,) float64
        Of the limb at each node, positive.
    edges : (E, 2) int64
    rule : TieRule

    Returns
    -------
    (E', 2) int64
    """
    if not len(edges):
        return edges
    length = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
    pieces, edge_of = _along(nodes, radius, edges, length)
    density = blurred_tubes(points, pieces, BLUR, _PIECE)
    size = np.maximum(length, np.finfo(float).tiny) * radius[edges].mean(axis=1)
    # Ends' tubes overlap in what is shorter: it stands for one limb that branches.
    apart = length >= radius[edges].sum(axis=1)
    held = explained_mass(density, mass, _TURNS)
    kept = np.arange(len(edges))
    while True:
        each = np.bincount(edge_of, held, minlength=len(edges)) / size
        share = each[kept] / max(float(np.median(each[kept])), np.finfo(float).tiny)
        tie = _weakest(nodes, edges[kept], share, apart[kept], rule)
        if tie is None:
            return edges[kept]
        held = np.where(edge_of == kept[tie], 0.0, held)
        kept = np.delete(kept, tie)
        held = explained_mass(density, mass, _AGAIN, held)


def _along(
    nodes: FloatArray, radius: FloatArray, edges: IntArray, length: FloatArray
) -> tuple[Pieces, IntArray]:
    """Return pieces of equal length along each edge, and the edge of each."""
    count = np.ceil(length / (_PIECE * radius[edges].mean(axis=1))).astype(np.int64)
    count = np.maximum(count, 1)
    edge_of = np.repeat(np.arange(len(edges)), count)
    first = np.repeat(np.cumsum(count) - count, count)
    t = (np.arange(len(edge_of)) - first + 0.5) / count[edge_of]
    start, end = edges[edge_of].T
    places = nodes[start] + t[:, None] * (nodes[end] - nodes[start])
    axes = (nodes[end] - nodes[start]) / np.maximum(length, np.finfo(float).tiny)[edge_of, None]
    return Pieces(places, axes, (1.0 - t) * radius[start] + t * radius[end]), edge_of


def _weakest(
    nodes: FloatArray, edges: IntArray, share: FloatArray, apart: NDArray[np.bool_], rule: TieRule
) -> int | None:
    """Return the edge between two limbs that holds least, where that is a tie."""
    count = len(nodes)
    degree = np.bincount(edges.ravel(), minlength=count)
    between = degree[edges].min(axis=1) >= 3
    weak = np.flatnonzero(between & (share < max(rule.loop, rule.between)))
    for k in weak[np.argsort(share[weak], kind="stable")].tolist():
        rest = np.delete(edges, k, axis=0)
        if not all(_passes(nodes, rest, node, rule.through) for node in edges[k].tolist()):
            continue
        piece = piece_labels(count, rest)
        looped = piece[edges[k, 0]] == piece[edges[k, 1]]
        least = rule.loop if looped else rule.between
        if share[k] < least and (looped or apart[k]):
            return int(k)
    return None


def _passes(nodes: FloatArray, edges: IntArray, node: int, through: float) -> bool:
    """Return whether a limb goes straight through a node: two of its edges lie opposite."""
    ways = nodes[edges[(edges == node).any(axis=1)].sum(axis=1) - node] - nodes[node]
    ways = ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), np.finfo(float).tiny)
    return bool((ways @ ways.T).min(initial=1.0) <= -through)
