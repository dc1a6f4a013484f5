"""Messages about nodes: candidates, the plan that serves them, the skeleton in the rough."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.arrays import (
    BoolArray,
    IntArray,
    finite_array,
    frozen_matrix,
    index_pairs,
    masses,
    numeric_array,
    set_fields,
)
from mdcs_pipeline.errors import InputError
from mdcs_pipeline.header import Header


def _unset() -> NDArray[Any]:
    return np.empty(0)


def _filled(given: NDArray[Any], default: NDArray[Any]) -> NDArray[Any]:
    """Return `default` where nothing was given."""
    return default if isinstance(given, np.ndarray) and given.shape == (0,) else given


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
    fixed : (m,) bool
        Nodes around what is updated: they compete for mass but neither move nor vanish, and
        `links` holds all edges between two of them.
    beyond : (m,) int64
        Fixed nodes of the same label hang together outside of what is updated; −1 for none.
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
    fixed: BoolArray = field(default_factory=_unset)
    beyond: IntArray = field(default_factory=_unset)
    header: Header = field(default_factory=Header)

    def __post_init__(self) -> None:
        positions = finite_array(self.positions, (None, 3), "positions")
        count = len(positions)
        if self.epsilon is not None and not (np.isfinite(self.epsilon) and self.epsilon > 0):
            raise InputError("epsilon must be positive", received=self.epsilon)
        scale = finite_array(_filled(self.scale, np.ones(count)), (count,), "scale")
        if count and scale.min() <= 0:
            raise InputError("scale must be positive", received=f"minimum {scale.min()}")
        set_fields(
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
            fixed=finite_array(_filled(self.fixed, np.zeros(count)), (count,), "fixed", np.bool_),
            beyond=finite_array(
                _filled(self.beyond, np.full(count, -1)), (count,), "beyond", np.int64
            ),
        )

    def __len__(self) -> int:
        return len(self.positions)

    def summary(self) -> dict[str, Any]:
        """Return the figures that a progress line shows."""
        return {"nodes": len(self), "epsilon": self.epsilon}


class _Late:
    """A plan that is made when it is asked for, once."""

    def __init__(self, make: Callable[[], sparse.csr_array]) -> None:
        self._make = make
        self._held: sparse.csr_array | None = None

    def made(self) -> sparse.csr_array:
        """Return the plan."""
        if self._held is None:
            self._held = self._make()
        return self._held


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
    entries : int
        Kernel entries read, over all passes.
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
    entries: int = 0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.epsilon) and self.epsilon > 0):
            raise InputError("epsilon must be positive", received=self.epsilon)
        potentials = finite_array(self.point_potentials, (None,), "point_potentials")
        set_fields(self, point_potentials=potentials)
        if isinstance(self.plan, _Late):
            set_fields(self, _late=self.plan)
            object.__delattr__(self, "plan")
        else:
            set_fields(self, plan=self._checked(self.plan))

    @classmethod
    def late(cls, make: Callable[[], sparse.csr_array], **fields: Any) -> TransportPlan:
        """Return a message whose plan is written out when it is first asked for.

        Parameters
        ----------
        make : callable
            Gives the plan, (n, m); called at most once, also for what `serving` returns.
        **fields
            All other fields.
        """
        return cls(plan=cast("sparse.csr_array", _Late(make)), **fields)

    def serving(self, nodes: Nodes) -> TransportPlan:
        """Return the same plan with its nodes relabelled; it is not written out for that."""
        # Looked up apart: to ask for the plan itself would make it.
        return replace(self, nodes=nodes, plan=vars(self).get("_late") or self.plan)

    def __getattr__(self, name: str) -> Any:
        # Reached only while the plan is missing: it is made, and there from then on.
        if name != "plan" or "_late" not in vars(self):
            raise AttributeError(name)
        set_fields(self, plan=self._checked(vars(self)["_late"].made()))
        return self.plan

    def _checked(self, plan: sparse.csr_array) -> sparse.csr_array:
        if plan.shape[1] != len(self.nodes):
            raise InputError(
                f"the plan must have one column for each of {len(self.nodes)} nodes",
                received=f"shape {plan.shape}",
            )
        data = finite_array(plan.data, (None,), "plan")
        if len(data) and data.min() < 0:
            raise InputError("the plan must not be negative", received=f"minimum {data.min()}")
        if plan.shape[0] != len(self.point_potentials):
            raise InputError(
                f"point_potentials must have the shape ({plan.shape[0]})",
                received=f"shape {self.point_potentials.shape}",
            )
        return frozen_matrix(plan)

    def summary(self) -> dict[str, Any]:
        """Return the figures that a progress line shows."""
        return {
            "nodes": len(self.nodes),
            "epsilon": self.epsilon,
            "passes": self.iterations,
            "entries": self.entries,
        }


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
        set_fields(
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
