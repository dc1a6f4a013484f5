"""Lengths, radii and volumes of a skeleton, branch by branch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.branches import split_branches
from mdcs_pipeline.kernels.loops import loop_basis

if TYPE_CHECKING:
    from mdcs_pipeline.skeleton import Skeleton

Kind = Literal["end-end", "end-junction", "junction-junction", "loop"]
TABLES = ("branches", "junctions", "loops")


@dataclass(frozen=True)
class Branch:
    """A path between ends and junctions; lengths in input units.

    Parameters
    ----------
    branch : int
        Its number, from 0.
    kind : {"end-end", "end-junction", "junction-junction", "loop"}
        What it joins. A loop comes back to where it starts.
    start, end : int
        Names of the nodes that it joins, of `Skeleton.node_ids`.
    nodes : int
        Nodes along it, both ends included.
    length : float
        Along the branch.
    chord : float
        Straight from start to end.
    radius_mean, radius_min, radius_max : float
        The mean is over the length.
    mass : float
        Of its nodes; a junction's is shared equally among the branches that meet there.
    volume : float
        Of the cones between neighbouring nodes, with the nodes' radii. An estimate: where
        branches meet, their cones overlap.
    """

    branch: int
    kind: Kind
    start: int
    end: int
    nodes: int
    length: float
    chord: float
    radius_mean: float
    radius_min: float
    radius_max: float
    mass: float
    volume: float


@dataclass(frozen=True)
class Junction:
    """A node where three branches or more meet."""

    node: int
    x: float
    y: float
    z: float
    radius: float
    degree: int
    branches: tuple[int, ...]


@dataclass(frozen=True)
class Loop:
    """A closed way along branches, one of the shortest that all loops are made of."""

    loop: int
    length: float
    branches: tuple[int, ...]


@dataclass(frozen=True)
class Measures:
    """What there is to measure on a skeleton.

    Parameters
    ----------
    summary : dict
        The counts of `Skeleton.summary`, ``isolated`` nodes, ``branches``, ``length`` of
        all branches, ``radius_min``, ``radius_max`` (None without nodes) and ``volume``,
        that of the branches and of a ball for each isolated node.
    branches : tuple of Branch
    junctions : tuple of Junction
    loops : tuple of Loop
        A shortest basis: as many as there are independent loops, of least total length.
    """

    summary: dict[str, Any]
    branches: tuple[Branch, ...]
    junctions: tuple[Junction, ...]
    loops: tuple[Loop, ...]


def measure(skeleton: Skeleton) -> Measures:
    """Return the branches, junctions and loops of a skeleton with their sizes.

    Parameters
    ----------
    skeleton : Skeleton

    Returns
    -------
    Measures
        Lengths in input units, volumes in their cube.

    Examples
    --------
    >>> import mdcs_pipeline as mdcs
    >>> for branch in mdcs.measure(skeleton).branches:  # doctest: +SKIP
    ...     print(branch.start, branch.end, branch.length)
    """
    paths = split_branches(len(skeleton), skeleton.edges)
    degree = np.bincount(skeleton.edges.ravel(), minlength=len(skeleton))
    branches = tuple(_branch(skeleton, k, path, degree) for k, path in enumerate(paths))
    alone = skeleton.radius[degree == 0]
    reach = skeleton.radius
    summary = {
        **skeleton.summary(),
        "isolated": len(alone),
        "branches": len(branches),
        "length": float(sum(branch.length for branch in branches)),
        "radius_min": float(reach.min()) if len(reach) else None,
        "radius_max": float(reach.max()) if len(reach) else None,
        "volume": float(sum(b.volume for b in branches) + 4 / 3 * np.pi * np.sum(alone**3)),
    }
    return Measures(summary, branches, _junctions(skeleton, paths, degree), _loops(branches))


def _branch(
    skeleton: Skeleton, number: int, path: NDArray[np.int64], degree: NDArray[np.int64]
) -> Branch:
    places, radius = skeleton.nodes[path], skeleton.radius[path]
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    length = float(steps.sum())
    near, far = radius[:-1], radius[1:]
    mean = (near + far) / 2
    # A node gives each of its edges the same part of its mass.
    part = skeleton.mass[path] / degree[path]
    start, end = int(path[0]), int(path[-1])
    return Branch(
        branch=number,
        kind=_kind(start, end, degree),
        start=int(skeleton.node_ids[start]),
        end=int(skeleton.node_ids[end]),
        nodes=len(np.unique(path)),
        length=length,
        chord=float(np.linalg.norm(places[-1] - places[0])),
        radius_mean=float(steps @ mean / length) if length else float(mean.mean()),
        radius_min=float(radius.min()),
        radius_max=float(radius.max()),
        mass=float(part[:-1].sum() + part[1:].sum()),
        volume=float(np.pi / 3 * (steps @ (near**2 + near * far + far**2))),
    )


def _kind(start: int, end: int, degree: NDArray[np.int64]) -> Kind:
    if start == end:
        return "loop"
    ends = int(degree[start] == 1) + int(degree[end] == 1)
    kinds: tuple[Kind, Kind, Kind] = ("junction-junction", "end-junction", "end-end")
    return kinds[ends]


def _junctions(
    skeleton: Skeleton, paths: list[NDArray[np.int64]], degree: NDArray[np.int64]
) -> tuple[Junction, ...]:
    meeting: dict[int, list[int]] = {int(i): [] for i in np.flatnonzero(degree > 2)}
    for number, path in enumerate(paths):
        for node in {int(path[0]), int(path[-1])} & meeting.keys():
            meeting[node].append(number)
    return tuple(
        Junction(
            int(skeleton.node_ids[node]),
            float(skeleton.nodes[node, 0]),
            float(skeleton.nodes[node, 1]),
            float(skeleton.nodes[node, 2]),
            float(skeleton.radius[node]),
            int(degree[node]),
            tuple(numbers),
        )
        for node, numbers in meeting.items()
    )


def _loops(branches: tuple[Branch, ...]) -> tuple[Loop, ...]:
    ends = np.array([(branch.start, branch.end) for branch in branches], np.int64)
    names, pairs = np.unique(ends.reshape(-1, 2), return_inverse=True)
    lengths = np.array([branch.length for branch in branches])
    found = loop_basis(len(names), pairs.reshape(-1, 2), lengths)
    return tuple(
        Loop(number, float(lengths[edges].sum()), tuple(edges))
        for number, edges in enumerate(found)
    )
