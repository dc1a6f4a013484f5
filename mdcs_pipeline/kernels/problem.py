"""A transport problem between a cloud and a few nodes, and its answer (section IV.E, Eq. 9-11)."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.blocks import Blocks, Boxes, Sites, boxed, filled, plan_of

FloatArray = NDArray[np.float64]

# Where answers are wanted to fewer digits than these, float32 holds them.
_SINGLE_TOLERANCE, _SINGLE_CUT = 1e-5, 1e-7


class Accuracy(NamedTuple):
    """How exactly a transport problem is solved.

    Parameters
    ----------
    tolerance : float
        L1 distance of the node marginal from ρ that ends the iteration.
    cut : float
        Kernel entries below this share of a point's largest are left out. Total variation
        of the plan against none left out, on a torus with ε from 0.001 to 0.02: 1e-3 costs
        at most 1e-3, 1e-5 at most 1e-5, 1e-8 at most 3e-7.
    max_passes : int
        Bound on kernel passes.
    precision : {"single", "double"}
        Digits that the kernel is kept in; float32 only where tolerance and cut leave it room.
        It halves time and memory, but small differences in the input can then end in
        differences of the order of the tolerance.
    """

    tolerance: float = 1e-3
    cut: float = 1e-5
    max_passes: int = 2000
    precision: Literal["single", "double"] = "single"

    @property
    def kind(self) -> type:
        """The type of number that kernels are kept in; float32 gives entries five digits."""
        room = self.tolerance >= _SINGLE_TOLERANCE and self.cut >= _SINGLE_CUT
        return np.float32 if room and self.precision == "single" else np.float64


class Problem(NamedTuple):
    """A transport problem with the cost c_ij = ‖x_i − y_j‖² / (r_i r_j).

    Parameters
    ----------
    points : (n, 3) float64
        y_j.
    mass : (n,) float64
        ϱ_j > 0.
    nodes : (m, 3) float64
        x_i.
    target : (m,) float64
        ρ_i ≥ 0, of the same sum as `mass`.
    epsilon : float
        ε, in units of c.
    point_scale, node_scale : (n,), (m,) float64
        r_j and r_i; all 1 for the plain squared distance.
    """

    points: FloatArray
    mass: FloatArray
    nodes: FloatArray
    target: FloatArray
    epsilon: float
    point_scale: FloatArray
    node_scale: FloatArray

    def boxes(self) -> Boxes:
        """Return the points in boxes; they serve until points, masses or r_j change."""
        return boxed(self.points, self.mass, self.point_scale)


class Carried(NamedTuple):
    """What a plan brings to each node.

    Parameters
    ----------
    received : (m,) float64
        Σ_j π_ij.
    pull : (m,) float64
        Σ_j π_ij / r_j.
    places : (m, 3) float64
        Σ_j π_ij y_j / r_j.
    scale : (m,) float64
        Σ_j π_ij r_j.
    """

    received: FloatArray
    pull: FloatArray
    places: FloatArray
    scale: FloatArray


class Solution(NamedTuple):
    """A solved transport problem.

    Parameters
    ----------
    plan : scipy.sparse.csr_array, (n, m)
    node_potentials, point_potentials : (m,), (n,) float64
        f and g, in cost units.
    passes : int
    marginal_error : float
        L1 distance of the node marginal from ρ.
    converged : bool
    entries : int
        Kernel entries read, over all passes.
    """

    plan: sparse.csr_array
    node_potentials: FloatArray
    point_potentials: FloatArray
    passes: int
    marginal_error: float
    converged: bool
    entries: int


class Coupling(NamedTuple):
    """A solved transport problem whose plan is not written out.

    Parameters
    ----------
    boxes : Boxes
    sites : Sites
        With the potentials that `blocks` was made for.
    blocks : Blocks or None
        The kernel; None where none was kept.
    scaling : (m,) float64
        u_i of the last pass, in the order of `sites`.
    carried : Carried
    node_potentials, point_potentials, passes, marginal_error, converged, entries
        As in `Solution`.
    """

    boxes: Boxes
    sites: Sites
    blocks: Blocks | None
    scaling: FloatArray
    carried: Carried
    node_potentials: FloatArray
    point_potentials: FloatArray
    passes: int
    marginal_error: float
    converged: bool
    entries: int

    @property
    def energy(self) -> float:
        """Σ π_ij c_ij − ε H(Π), H = −Σ π ln π (Eq. 4 and 9).

        For a plan of the form exp((f + g − c)/ε), each entry has ε ln π + c = f + g, so that
        the sum is that of the potentials over the plan's own marginals.
        """
        sent = self.boxes.mass @ self.point_potentials[self.boxes.order]
        return float(self.carried.received @ self.node_potentials + sent)

    def solution(self, epsilon: float, accuracy: Accuracy) -> Solution:
        """Return the solution with its plan."""
        blocks = self.blocks
        if blocks is None:
            blocks = filled(self.boxes, self.sites, epsilon, accuracy.cut, accuracy.kind)
        plan = plan_of(self.boxes, self.sites, blocks, self.scaling)
        return Solution(
            plan,
            self.node_potentials,
            self.point_potentials,
            self.passes,
            self.marginal_error,
            self.converged,
            self.entries,
        )
