"""Messages: the frozen, validated values that travel between stages.

`PointCloud` and `Skeleton` are in the user's units and frame. What lies between
them (`MassCloud`, `Nodes`, `TransportPlan`, `RoughSkeleton`) is in the unit frame
of the cloud, where the method's ε has its meaning; `MassCloud.unit` leads back.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    finite_array,
    frozen_view,
    index_pairs,
    masses,
    numeric_array,
    points_array,
)
from mdcs_pipeline.errors import InputError
from mdcs_pipeline.header import Header
from mdcs_pipeline.skeleton import Skeleton

__all__ = [
    "Header",
    "MassCloud",
    "Nodes",
    "PointCloud",
    "RoughSkeleton",
    "Skeleton",
    "Surface",
    "Thickness",
    "TransportPlan",
    "UnitFrame",
]


def _freeze(message: object, **values: object) -> None:
    for name, value in values.items():
        object.__setattr__(message, name, value)


def _frozen_matrix(matrix: sparse.csr_array) -> sparse.csr_array:
    """Return a read-only matrix on the same entries; the caller's own stays writable."""
    parts = (matrix.data, matrix.indices, matrix.indptr)
    frozen = sparse.csr_array(parts, shape=matrix.shape, copy=False)
    for part in ("data", "indices", "indptr"):
        setattr(frozen, part, frozen_view(getattr(frozen, part)))
    return frozen


def _unset() -> NDArray[Any]:
    return np.empty(0)


def _filled(given: NDArray[Any], default: NDArray[Any]) -> NDArray[Any]:
    """Return `default` where nothing was given."""
    return default if isinstance(given, np.ndarray) and given.shape == (0,) else given


@dataclass(frozen=True, eq=False)
class PointCloud:
    """A point cloud in the user's units and frame.

    Parameters
    ----------
    positions : (N, 3) float32 or float64
        Coordinates; other numeric types become float64. Finite.
    weights : (N,) float64, optional
        How many measured points each point stands for; all 1 when absent.
    header : Header
    dropped : int
        Points left out on the way in because a coordinate was not finite.
    """

    positions: FloatArray
    weights: NDArray[np.float64] | None = None
    header: Header = field(default_factory=Header)
    dropped: int = 0

    def __post_init__(self) -> None:
        positions = points_array(self.positions, "positions")
        _freeze(self, positions=finite_array(positions, (None, 3), "positions", positions.dtype))
        if self.weights is not None:
            weights = finite_array(self.weights, (len(positions),), "weights")
            if len(weights) and weights.min() <= 0:
                raise InputError("weights must be positive", received=f"minimum {weights.min()}")
            _freeze(self, weights=weights)

    def __len__(self) -> int:
        return len(self.positions)

    def summary(self) -> dict[str, Any]:
        """Return the figures that a progress line shows."""
        return {"points": len(self)}


@dataclass(frozen=True, eq=False)
class UnitFrame:
    """The similarity that takes the user's frame to the cloud's unit frame.

    Parameters
    ----------
    centre : (3,) float64
        Origin of the unit frame, in input units.
    axes : (3, 3) float64
        Its axes as rows, a right-handed orthonormal basis.
    length : float
        Input units per unit length.
    """

    centre: NDArray[np.float64]
    axes: NDArray[np.float64]
    length: float

    def __post_init__(self) -> None:
        axes = finite_array(self.axes, (3, 3), "axes")
        if not np.allclose(axes @ axes.T, np.eye(3), atol=1e-9) or np.linalg.det(axes) < 0:
            raise InputError("axes must be orthonormal, right-handed", received=axes.tolist())
        if not (np.isfinite(self.length) and self.length > 0):
            raise InputError("length must be positive", received=self.length)
        _freeze(self, centre=finite_array(self.centre, (3,), "centre"), axes=axes)

    def to_unit(self, points: FloatArray) -> NDArray[np.float64]:
        """Map (N, 3) points of the user's frame into the unit frame."""
        return np.ascontiguousarray(((points - self.centre) / self.length) @ self.axes.T)

    def from_unit(self, points: FloatArray) -> NDArray[np.float64]:
        """Map (N, 3) points of the unit frame back to the user's."""
        return np.ascontiguousarray((points @ self.axes) * self.length + self.centre)


@dataclass(frozen=True, eq=False)
class MassCloud:
    """The measure ν of section IV.A: points with mass, in the unit frame.

    Parameters
    ----------
    positions : (n, 3) float64
        y_j in the unit frame.
    mass : (n,) float64
        ϱ_j, positive, sum 1.
    unit : UnitFrame
        Leads back to input units.
    header : Header
    """

    positions: NDArray[np.float64]
    mass: NDArray[np.float64]
    unit: UnitFrame
    header: Header = field(default_factory=Header)

    def __post_init__(self) -> None:
        positions = finite_array(self.positions, (None, 3), "positions")
        _freeze(self, positions=positions, mass=masses(self.mass, len(positions)))

    def __len__(self) -> int:
        return len(self.positions)

    def summary(self) -> dict[str, Any]:
        """Return the figures that a progress line shows."""
        return {"points": len(self)}


@dataclass(frozen=True, eq=False)
class Surface:
    """Which points of a cloud are neighbours on the shape, and how far apart.

    Parameters
    ----------
    positions : (n, 3) float64
        The cloud's points, freed of some of their noise, in the unit frame.
    graph : scipy.sparse.csr_array, (n, n)
        Symmetric; distances between neighbours in unit lengths.
    """

    positions: NDArray[np.float64]
    graph: sparse.csr_array

    def __post_init__(self) -> None:
        positions = finite_array(self.positions, (None, 3), "positions")
        if self.graph.shape != (len(positions),) * 2:
            raise InputError(
                f"the graph must have one row for each of {len(positions)} points",
                received=f"shape {self.graph.shape}",
            )
        lengths = finite_array(self.graph.data, (None,), "graph")
        if len(lengths) and lengths.min() <= 0:
            raise InputError("distances must be positive", received=f"minimum {lengths.min()}")
        _freeze(self, positions=positions, graph=_frozen_matrix(self.graph))

    def summary(self) -> dict[str, Any]:
        """Return the figures that a progress line shows."""
        return {"links": self.graph.nnz // 2}


@dataclass(frozen=True, eq=False)
class Thickness:
    """The local scale of a shape: half its width around each point.

    Parameters
    ----------
    radius : (n,) float64
        r_j in unit lengths, positive.
    confidence : (n,) float64
        In [0, 1]: 1 where the patch around a point was seen to close into a tube, less the
        farther the value was carried over the surface.
    """

    radius: NDArray[np.float64]
    confidence: NDArray[np.float64]

    def __post_init__(self) -> None:
        radius = finite_array(self.radius, (None,), "radius")
        if len(radius) and radius.min() <= 0:
            raise InputError("radius must be positive", received=f"minimum {radius.min()}")
        confidence = finite_array(self.confidence, (len(radius),), "confidence")
        _freeze(self, radius=radius, confidence=confidence)

    def summary(self) -> dict[str, Any]:
        """Return the figures that a progress line shows."""
        return {"radius": float(np.median(self.radius)) if len(self.radius) else 0.0}


@dataclass(frozen=True, eq=False)
class Nodes:
    """The measure μ of section IV.A: candidate skeleton nodes, in the unit frame.

    Parameters
    ----------
    positions : (m, 3) float64
        x_i in the unit frame.
    mass : (m,) float64
        ρ_i, sum 1.
    potentials : (m,) float64
        f_i in cost units; zeros before any transport.
    epsilon : float or None
        ε that the nodes ask to be transported with; None leaves it to the stage.
    ids : (m,) int64
        Names that survive merging.
    links : (E, 2) int64
        Connections kept from earlier rounds (section IV.B), i < j.
    settled : (m,) bool
        l_i of Algorithm 1: labelled as points of the curve skeleton.
    scale : (m,) float64
        r_i of the thickness-normalised cost, in unit lengths; 1 without a thickness.
    rounds : int
        Times that a check has sent the nodes back.
    header : Header
    """

    positions: NDArray[np.float64]
    mass: NDArray[np.float64]
    potentials: NDArray[np.float64] = field(default_factory=_unset)
    epsilon: float | None = None
    ids: IntArray = field(default_factory=_unset)
    links: IntArray = field(default_factory=lambda: np.empty((0, 2), np.int64))
    settled: BoolArray = field(default_factory=_unset)
    scale: NDArray[np.float64] = field(default_factory=_unset)
    rounds: int = 0
    header: Header = field(default_factory=Header)

    def __post_init__(self) -> None:
        positions = finite_array(self.positions, (None, 3), "positions")
        count = len(positions)
        if self.epsilon is not None and not (np.isfinite(self.epsilon) and self.epsilon > 0):
            raise InputError("epsilon must be positive", received=self.epsilon)
        scale = finite_array(_filled(self.scale, np.ones(count)), (count,), "scale")
        if count and scale.min() <= 0:
            raise InputError("scale must be positive", received=f"minimum {scale.min()}")
        _freeze(
            self,
            positions=positions,
            mass=masses(self.mass, count),
            potentials=finite_array(
                _filled(self.potentials, np.zeros(count)), (count,), "potentials"
            ),
            ids=finite_array(_filled(self.ids, np.arange(count)), (count,), "ids", np.int64),
            links=index_pairs(self.links, count, "links"),
            settled=finite_array(
                _filled(self.settled, np.zeros(count)), (count,), "settled", np.bool_
            ),
            scale=scale,
        )

    def __len__(self) -> int:
        return len(self.positions)

    def summary(self) -> dict[str, Any]:
        """Return the figures that a progress line shows."""
        return {"nodes": len(self), "epsilon": self.epsilon}


@dataclass(frozen=True, eq=False)
class TransportPlan:
    """An entropic plan Π between a `MassCloud` and `Nodes` (Eq. 9-11).

    π_ij = exp((f_i + g_j − c_ij)/ε), c_ij = d_ij² or, over a thickness, d_ij²/(r_i r_j).

    Parameters
    ----------
    nodes : Nodes
        The nodes that the plan serves, with f as their potentials.
    plan : scipy.sparse.csr_array, (n, m)
        π_ij by point (rows j) and node (columns i).
    point_potentials : (n,) float64
        g_j in cost units.
    epsilon : float
        ε in cost units.
    iterations : int
        Sinkhorn passes.
    marginal_error : float
        L1 distance of the node marginal to ρ; the point marginal is exact.
    converged : bool
        Whether the marginal error met its tolerance and the positions settled.
    warm : bool
        Whether the solve started from given potentials.
    energy : tuple of float
        Objective of Algorithm 2 after each of its steps.
    """

    nodes: Nodes
    plan: sparse.csr_array
    point_potentials: NDArray[np.float64]
    epsilon: float
    iterations: int
    marginal_error: float
    converged: bool
    warm: bool
    energy: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        count = self.plan.shape[0]
        if self.plan.shape[1] != len(self.nodes):
            raise InputError(
                f"the plan must have one column for each of {len(self.nodes)} nodes",
                received=f"shape {self.plan.shape}",
            )
        if not (np.isfinite(self.epsilon) and self.epsilon > 0):
            raise InputError("epsilon must be positive", received=self.epsilon)
        data = finite_array(self.plan.data, (None,), "plan")
        if len(data) and data.min() < 0:
            raise InputError("the plan must not be negative", received=f"minimum {data.min()}")
        potentials = finite_array(self.point_potentials, (count,), "point_potentials")
        _freeze(self, plan=_frozen_matrix(self.plan), point_potentials=potentials)

    def summary(self) -> dict[str, Any]:
        """Return the figures that a progress line shows."""
        return {"nodes": len(self.nodes), "epsilon": self.epsilon, "passes": self.iterations}


@dataclass(frozen=True, eq=False)
class RoughSkeleton:
    """A skeleton before geometry optimisation (section IV.B-C), in the unit frame.

    Parameters
    ----------
    plan : TransportPlan
        The plan that its edges were read from; it holds the nodes.
    edges : (E, 2) int64
        i < j.
    skeletal : (m,) bool
        Nodes whose points send their mass to a line-like structure.
    """

    plan: TransportPlan
    edges: IntArray
    skeletal: BoolArray

    def __post_init__(self) -> None:
        count = len(self.plan.nodes)
        skeletal = numeric_array(self.skeletal, "skeletal")
        _freeze(
            self,
            edges=index_pairs(self.edges, count),
            skeletal=finite_array(skeletal, (count,), "skeletal", np.bool_),
        )

    @property
    def nodes(self) -> Nodes:
        """The nodes of the plan."""
        return self.plan.nodes

    def summary(self) -> dict[str, Any]:
        """Return the figures that a progress line shows."""
        return {
            "nodes": len(self.nodes),
            "edges": len(self.edges),
            "epsilon": self.plan.epsilon,
            "skeletal": int(np.count_nonzero(self.skeletal)),
        }
