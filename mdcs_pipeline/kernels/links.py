"""Connections between nodes, read from the plan."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.compiled.common import common_mass

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Indices below which a pair of them fits into one number.
_MOST = 1 << 31
# Pairs of nodes up to which each has a place of its own to be summed in.
_DENSE = 1 << 16


class Links(NamedTuple):
    """Weighted connections, each once.

    Parameters
    ----------
    pairs : (E, 2) int64
        i < j.
    strength : (E,) float64
        In the unit of the rule that made them.
    """

    pairs: IntArray
    strength: FloatArray


def unique_pairs(pairs: IntArray) -> IntArray:
    """Return the (E, 2) pairs with i < j, sorted, each once, without i = j."""
    ordered = np.sort(pairs.reshape(-1, 2), axis=1)
    kept = ordered[ordered[:, 0] != ordered[:, 1]]
    if not len(kept):
        return np.empty((0, 2), np.int64)
    base = int(kept.max()) + 1
    if kept.min() < 0 or base > _MOST:
        return np.unique(kept, axis=0)
    # One number a pair sorts many times faster than rows do.
    names = np.unique(kept[:, 0] * base + kept[:, 1])
    return np.stack(np.divmod(names, base), axis=1)


def named_pairs(top: IntArray, shares: FloatArray, two_share: float) -> IntArray:
    """Return the pairs (x_1, x_2), and (x_1, x_3) of points that need three (section IV.B).

    Parameters
    ----------
    top : (n, 3) int64
    shares : (n, 3) float64
    two_share : float

    Returns
    -------
    (E, 2) int64
    """
    first = top[top[:, 1] >= 0][:, [0, 1]]
    three = (shares[:, 0] + shares[:, 1] <= two_share) & (top[:, 2] >= 0)
    return unique_pairs(np.concatenate([first, top[three][:, [0, 2]]]))


def shared_mass(plan: sparse.csr_array, floor: float) -> Links:
    """Return Σ (π_ij + π_kj) over the points that send mass to both i and k.

    The text's noise check drops a link where this is under 0.1 (ρ_i + ρ_k).

    Parameters
    ----------
    plan : csr_array, (n, m)
    floor : float
        Shares below this do not count as sending mass.

    Returns
    -------
    Links
    """
    kept = _without_small(plan, floor)
    serves = sparse.csr_array(
        (np.ones_like(kept.data), kept.indices, kept.indptr), shape=kept.shape
    )
    one_way = sparse.coo_array(kept.T @ serves)
    return _upper(sparse.csr_array(one_way + one_way.T))


def co_transport(plan: sparse.csr_array, mass: FloatArray, floor: float) -> Links:
    """Return W_ik = Σ_j π_ij π_kj / ϱ_j relative to min(ρ_i, ρ_k).

    The mass that the two nodes would exchange if it went from node to point and back at
    random: the second-order walk on the plan. It is symmetric, needs no single point's vote,
    and is 0 without common points.

    Parameters
    ----------
    plan : csr_array, (n, m)
    mass : (n,) float64
        ϱ_j.
    floor : float
        Shares below this are left out.

    Returns
    -------
    Links
    """
    kept = _without_small(plan, floor)
    node_mass = np.bincount(plan.indices, plan.data, minlength=plan.shape[1]).astype(np.float64)
    if len(node_mass) ** 2 <= _DENSE:
        shared = common_mass(kept.indptr, kept.indices, kept.data, 1.0 / mass, len(node_mass))
        first, second = np.nonzero(shared)
        links = Links(np.stack([first, second], axis=1), shared[first, second])
        return _relative(links, node_mass)
    each = np.repeat(1.0 / mass, np.diff(kept.indptr))
    scaled = sparse.csr_array((each * kept.data, kept.indices, kept.indptr), shape=kept.shape)
    return _relative(_upper(sparse.csr_array(kept.T @ scaled)), node_mass)


def _relative(links: Links, node_mass: FloatArray) -> Links:
    smaller = node_mass[links.pairs].min(axis=1)
    return Links(links.pairs, links.strength / np.maximum(smaller, np.finfo(float).tiny))


def straight_ahead(nodes: FloatArray, edges: IntArray, pairs: IntArray) -> FloatArray:
    """Return how straight each pair goes on from an end of what edges connect.

    Parameters
    ----------
    nodes : (m, 3) float64
    edges : (E, 2) int64
    pairs : (P, 2) int64

    Returns
    -------
    (P, 2) float64
        Cosine at each node of the pair: 1 where it has no edges and looks anywhere, −1 where it
        is no end.
    """
    degree = np.bincount(edges.ravel(), minlength=len(nodes))
    outward = np.zeros((len(nodes), 3))
    for near, far in (edges.T, edges.T[::-1]):
        end = degree[near] == 1
        outward[near[end]] = nodes[near[end]] - nodes[far[end]]
    ahead = np.empty(pairs.shape)
    for k, (near, far) in enumerate((pairs.T, pairs.T[::-1])):
        way = nodes[far] - nodes[near]
        length = np.linalg.norm(way, axis=1) * np.linalg.norm(outward[near], axis=1)
        cosine = (way * outward[near]).sum(axis=1) / np.where(length > 0, length, 1.0)
        ahead[:, k] = np.where(degree[near] == 1, cosine, np.where(degree[near] == 0, 1.0, -1.0))
    return ahead


def gone_on(nodes: FloatArray, edges: IntArray, links: Links, least: FloatArray) -> IntArray:
    """Return the edges and, for each end, the strongest link that goes straight on from it.

    An end is a node with one edge. Two that face each other share one link.

    Parameters
    ----------
    nodes : (m, 3) float64
    edges : (E, 2) int64
        i < j.
    links : Links
    least : (L, 2) float64
        Least cosines that are straight on: of the straighter of a link's two nodes, and of the
        other. A node that is no end has −1, one without edges 1.

    Returns
    -------
    (F, 2) int64
    """
    ahead = np.sort(straight_ahead(nodes, edges, links.pairs), axis=1)[:, ::-1]
    degree = np.bincount(edges.ravel(), minlength=len(nodes))
    ends = (degree[links.pairs] == 1).any(axis=1)
    name = [len(nodes), 1]
    onward = ends & (ahead >= least).all(axis=1) & ~np.isin(links.pairs @ name, edges @ name)
    taken, added = np.zeros(len(nodes), dtype=np.bool_), []
    for k in np.flatnonzero(onward)[np.argsort(-links.strength[onward], kind="stable")]:
        joined = [n for n in links.pairs[k] if degree[n] == 1]
        if not taken[joined].any():
            taken[joined] = True
            added.append(links.pairs[k])
    return unique_pairs(np.concatenate([edges, *(pair[None] for pair in added)]))


def _without_small(plan: sparse.csr_array, floor: float) -> sparse.csr_array:
    rows = np.repeat(np.arange(plan.shape[0]), np.diff(plan.indptr))
    totals = np.bincount(rows, plan.data, minlength=plan.shape[0])
    kept = plan.data > floor * totals[rows]
    ends = np.concatenate([[0], np.cumsum(kept)])[plan.indptr].astype(plan.indptr.dtype)
    return sparse.csr_array((plan.data[kept], plan.indices[kept], ends), shape=plan.shape)


def _upper(matrix: sparse.csr_array) -> Links:
    upper = sparse.coo_array(sparse.triu(matrix, k=1))
    order = np.lexsort((upper.col, upper.row))
    pairs = np.stack([upper.row[order], upper.col[order]], axis=1).astype(np.int64)
    return Links(pairs, np.asarray(upper.data[order], dtype=np.float64))


def widened(plan: sparse.csr_array, mass: FloatArray, factor: float) -> sparse.csr_array:
    """Return the plan with the same potentials at `factor` · ε, points' mass kept.

    exp((f − d²)/(factor ε)) = exp((f − d²)/ε)^(1/factor), so a row only needs its power.
    """
    rows = np.repeat(np.arange(plan.shape[0]), np.diff(plan.indptr))
    powered = plan.data ** (1.0 / factor)
    totals = np.bincount(rows, powered, minlength=plan.shape[0])
    data = powered * (mass / np.maximum(totals, np.finfo(float).tiny))[rows]
    return sparse.csr_array((data, plan.indices, plan.indptr), shape=plan.shape)
