"""The final skeleton: points inserted, places optimised, back in input units."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import sparse
from scipy.spatial import cKDTree

from mdcs_pipeline.arrays import IntArray
from mdcs_pipeline.ingest import given_cloud
from mdcs_pipeline.kernels.assignment import owners, plan_owners
from mdcs_pipeline.kernels.bends import (
    bends_in_scatter,
    sideways_scatter,
    steps_in_radii,
    without,
)
from mdcs_pipeline.kernels.ends import limb_ends, lone_segments, stretched
from mdcs_pipeline.kernels.energy import mean_distance
from mdcs_pipeline.kernels.insertion import Refined, insert_points
from mdcs_pipeline.kernels.optimise import Descent, Optimised, optimise
from mdcs_pipeline.kernels.problem import Accuracy, Coupling, Problem
from mdcs_pipeline.kernels.sinkhorn import couple_free
from mdcs_pipeline.messages import MassCloud, PointCloud, RoughSkeleton, Skeleton, Thickness
from mdcs_pipeline.stage import Settings, Stage
from mdcs_pipeline.stages.transport import carried_from

_ACCURACY = Accuracy()
_DESCENT = Descent()


class SmoothSettings(Settings):
    """Settings of `Smooth`."""

    smoothing: float = Field(
        0.3, ge=0, lt=1, description="λ, weight of the Dirichlet term (Eq. 1, Table III)."
    )
    bends: Literal["steps", "scatter"] = Field(
        "steps",
        description="What that term counts. steps: ‖x_i − mean of its neighbours‖² in local radii "
        "(Eq. 8); scatter: Σ ρ_i (κ_i w_i² / r_i)², κ the curvature and w how far a node's mass "
        "scatters sideways: what is known well may bend, and spacing does not matter.",
    )
    theta: float = Field(
        _DESCENT.step, gt=0, le=1, description="θ, relaxation of the update (Table III)."
    )
    power: Literal[1, 2] = Field(_DESCENT.power, description="p of the node update (Eq. 12).")
    max_steps: int = Field(100, ge=0, le=10_000, description="Bound on updates of the nodes.")
    settle: float = Field(
        _DESCENT.settle,
        ge=0,
        description="The loop ends when a step lowers the objective by less, in ε.",
    )
    narrowing: float = Field(
        0.25,
        gt=0,
        le=1,
        description="ε of the final plan, in that of the rough skeleton: nodes stand closer now.",
    )
    stretch: bool = Field(
        True, description="Whether ends first move out to the centre of their limb's tip."
    )
    carried: Literal["surface", "centre"] = Field(
        "surface", description="What the plan carries mass from, as in transport."
    )
    insert: bool = Field(True, description="Whether points are inserted into edges (Eq. 7).")
    spacing: float = Field(
        0.0,
        ge=0,
        description="Largest spacing of inserted points, in local radii; 0 takes the length of the "
        "shortest edge for all (Eq. 7).",
    )
    least_spacing: float = Field(
        0.4,
        gt=0,
        description="Shortest edge that is taken, in median edges: one tiny edge would otherwise "
        "cut all others to its size.",
    )
    tolerance: float = Field(
        _ACCURACY.tolerance,
        gt=0,
        le=0.5,
        description="L1 error of the node marginal that ends the iteration.",
    )
    cut: float = Field(
        _ACCURACY.cut,
        gt=0,
        lt=1,
        description="Kernel entries below this share of a row's largest go.",
    )
    precision: Literal["single", "double"] = Field(
        "double",
        description="Numbers that the kernel is kept in; places are final here, and single "
        "would move them with the last digits of the input.",
    )
    assign: bool = Field(
        False, description="Whether the result names the node of every input point."
    )


class Smoothed(NamedTuple):
    """Output of `Smooth`."""

    skeleton: Skeleton


class Smooth(Stage[SmoothSettings]):
    """Insert points and minimise Eq. 1 with its Dirichlet term (section IV.D)."""

    Settings = SmoothSettings

    def __call__(
        self,
        cloud: MassCloud,
        rough: RoughSkeleton,
        thickness: Thickness | None = None,
        points: PointCloud | None = None,
    ) -> Smoothed:
        """Return the skeleton in input units.

        `points` are those that `assign` names nodes for; without them, those of the cloud.
        """
        refined = self._refine(cloud, rough, thickness)
        found = self._optimise(cloud, rough, thickness, refined)
        solution, nodes = found.written(), found.problem.nodes
        received = np.bincount(solution.plan.indices, solution.plan.data, minlength=len(nodes))
        radius = mean_distance(solution.plan, cloud.positions, nodes) * cloud.unit.length
        skeleton = Skeleton(
            nodes=cloud.unit.from_unit(nodes),
            edges=refined.edges,
            mass=received / received.sum(),
            radius=radius,
            node_ids=_names(rough.nodes.ids, len(nodes)),
            assignment=self._assignment(cloud, found, points),
            header=cloud.header,
            diagnostics={
                "points": len(cloud),
                "epsilon": rough.plan.epsilon,
                "passes": solution.passes,
                "marginal_error": solution.marginal_error,
                "converged": bool(solution.converged and found.settled),
                "rough_nodes": len(rough.nodes),
                "checks": rough.nodes.rounds,
            },
        )
        return Smoothed(skeleton)

    def _refine(
        self, cloud: MassCloud, rough: RoughSkeleton, thickness: Thickness | None
    ) -> Refined:
        nodes, edges = rough.nodes, rough.edges
        positions = nodes.positions
        values = np.stack([nodes.mass, nodes.scale, nodes.potentials], axis=1)
        if self.settings.stretch:
            owner = plan_owners(rough.plan.plan)
            ends = limb_ends(positions, nodes.scale, edges, cloud.positions, owner, but=nodes.fixed)
            positions = stretched(positions, ends)
            places = carried_from(cloud, thickness, self.settings.carried)
            for node, tips in lone_segments(nodes.positions, edges, cloud.positions, owner, places):
                if node < len(nodes) and nodes.fixed[node]:
                    continue
                edges = np.concatenate([edges, [[node, len(positions)]]])
                positions[node] = tips[0]
                positions = np.concatenate([positions, tips[1:]])
                values = np.concatenate([values, values[[node]]])
        if not (self.settings.insert and len(edges)):
            return Refined(positions, values, edges)
        return insert_points(
            positions, values, edges, self._spacing(positions, edges, values[:, 1])
        )

    def _spacing(
        self, positions: NDArray[np.float64], edges: IntArray, scale: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the largest spacing of points on each edge, (E,)."""
        if self.settings.spacing > 0:
            return np.asarray(self.settings.spacing * scale[edges].mean(axis=1), dtype=np.float64)
        length = np.linalg.norm(positions[edges[:, 0]] - positions[edges[:, 1]], axis=1)
        shortest = max(float(length.min()), self.settings.least_spacing * float(np.median(length)))
        return np.full(len(edges), shortest)

    def _optimise(
        self,
        cloud: MassCloud,
        rough: RoughSkeleton,
        thickness: Thickness | None,
        refined: Refined,
    ) -> Optimised:
        settings = self.settings
        count = len(refined.positions)
        problem = Problem(
            carried_from(cloud, thickness, settings.carried),
            cloud.mass,
            refined.positions,
            np.full(count, 1.0 / count),
            rough.plan.epsilon * settings.narrowing,
            np.ones(len(cloud)) if thickness is None else thickness.radius,
            np.ones(count) if thickness is None else refined.values[:, 1],
        )
        accuracy = Accuracy(settings.tolerance, settings.cut, precision=settings.precision)
        # Interpolated masses would be those of no plan: each node is given what reaches it.
        level = couple_free(problem, np.zeros(count), accuracy)
        floor = 1e-6 / count
        target = np.maximum(level.carried.received, floor)
        problem = problem._replace(target=target / target.sum())
        descent = Descent(
            settings.power,
            settings.theta,
            settings.max_steps,
            settings.settle,
            False,
            settings.smoothing,
        )
        fixed = np.zeros(count, dtype=bool)
        fixed[: len(rough.nodes)] = rough.nodes.fixed
        bends = None
        if settings.smoothing > 0:
            bends = without(self._bends(problem, level, accuracy, refined.edges), fixed)
        return optimise(problem, level.node_potentials, accuracy, descent, bends, fixed)

    def _bends(
        self, problem: Problem, level: Coupling, accuracy: Accuracy, edges: IntArray
    ) -> sparse.csr_array:
        if self.settings.bends == "steps":
            return steps_in_radii(edges, problem.node_scale)
        plan = level.solution(problem.epsilon, accuracy).plan
        scatter = sideways_scatter(plan, problem.points, problem.nodes, edges)
        return bends_in_scatter(problem.nodes, edges, problem.node_scale, problem.target, scatter)

    def _assignment(
        self, cloud: MassCloud, found: Optimised, points: PointCloud | None
    ) -> NDArray[np.int64] | None:
        if not self.settings.assign:
            return None
        problem, places, scale = found.problem, cloud.positions, found.problem.point_scale
        if points is not None:
            places = cloud.unit.to_unit(given_cloud(points).positions)
            scale = scale[cKDTree(cloud.positions).query(places)[1]]
        potentials = found.coupling.node_potentials
        return owners(places, problem.nodes, potentials, scale, problem.node_scale)


def _names(ids: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return `ids` followed by unused ones for inserted points."""
    first = int(ids.max(initial=-1)) + 1
    return np.concatenate([ids, np.arange(first, first + count - len(ids))])
