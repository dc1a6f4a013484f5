"""Edges between limbs that no points are left for: noisy bars with known edges, and the stage."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from mdcs_pipeline.kernels.ridges import Ridges, levelled
from mdcs_pipeline.kernels.ties import TieRule, untied
from mdcs_pipeline.messages import Nodes, PointCloud, RoughSkeleton, Surface
from mdcs_pipeline.stages.density import Density
from mdcs_pipeline.stages.surface import SurfaceGraph
from mdcs_pipeline.stages.transport import Transport
from mdcs_pipeline.stages.untie import Untie

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

R, RULE = 0.1, TieRule()
X = np.array([1.0, 0.0, 0.0])
# Nodes of a bar, one radius apart, from 0 to 1.6.
ALONG = np.arange(17) * R


def tube(start: FloatArray, end: FloatArray, noise: float, seed: int) -> FloatArray:
    """Return 1,500 points per unit length about a tube of radius R, with noise in that radius."""
    rng = np.random.default_rng(seed)
    way = end - start
    length = float(np.linalg.norm(way))
    axes = np.linalg.svd(way[None])[2]
    count = int(1500 * length)
    angle, along = rng.uniform(0, 2 * np.pi, count), rng.uniform(0, 1, count)
    skin = R * (np.cos(angle)[:, None] * axes[1] + np.sin(angle)[:, None] * axes[2])
    return start + along[:, None] * way + skin + noise * R * rng.normal(size=(count, 3))


class Bars(NamedTuple):
    """Two bars side by side, and the edges along them."""

    points: FloatArray
    nodes: FloatArray
    edges: IntArray


def bars(gap: float, noise: float, seed: int = 0) -> Bars:
    """Return bars along x whose axes are `gap` apart."""
    far = np.array([0.0, gap, 0.0])
    points = [tube(far * k, far * k + 1.6 * X, noise, 2 * seed + k) for k in (0, 1)]
    nodes = np.concatenate([ALONG[:, None] * X + far * k for k in (0, 1)])
    one = np.stack([np.arange(16), np.arange(1, 17)], axis=1)
    return Bars(np.concatenate(points), nodes, np.concatenate([one, one + 17]))


def left(points: FloatArray, nodes: FloatArray, edges: IntArray, rule: TieRule = RULE) -> IntArray:
    mass = np.full(len(points), 1.0 / len(points))
    return untied(points, mass, nodes, np.full(len(nodes), R), edges, rule)


@pytest.mark.parametrize("noise", [0.3, 0.5])
@pytest.mark.parametrize("seed", [0, 1])
def test_ties_between_bars_go_and_the_bars_stay(noise: float, seed: int) -> None:
    two = bars(2.5 * R, noise, seed)
    ties = np.array([[4, 21], [8, 26], [12, 29]])
    found = left(two.points, two.nodes, np.concatenate([two.edges, ties])).tolist()
    assert found[: len(two.edges)] == two.edges.tolist()
    # What would take the bars apart is looked at more strictly.
    assert len(found) - len(two.edges) <= 1


@pytest.mark.parametrize("noise", [0.3, 0.5])
def test_a_rung_that_points_stand_around_stays(noise: float) -> None:
    two = bars(5.0 * R, noise)
    rungs = [tube(two.nodes[k], two.nodes[k + 17], noise, 10 + k) for k in (4, 12)]
    points = np.concatenate([two.points, *rungs])
    edges = np.concatenate([two.edges, [[4, 21], [12, 29], [8, 25]]])
    assert left(points, two.nodes, edges).tolist() == edges[:-1].tolist()


def test_what_branches_off_a_limb_keeps_its_root() -> None:
    """The root lies within the limb, whose points are its own; but a branch goes on from it."""
    rail = tube(0 * X, 1.6 * X, 0.4, 0)
    far = np.array([0.0, 1.0, 0.0])
    points = np.concatenate([rail, tube(0.8 * X + R * far, 0.8 * X + far, 0.4, 1)])
    branch = 0.8 * X + np.array([0.9, 3.0, 6.0, 9.0])[:, None] * R * far
    nodes = np.concatenate([ALONG[:, None] * X, branch])
    chain = np.stack([np.arange(20), np.arange(1, 21)], axis=1)
    edges = np.concatenate([np.delete(chain, 16, axis=0), [[8, 17]]])
    assert left(points, nodes, edges).tolist() == edges.tolist()


def test_the_only_edge_between_two_pieces_needs_to_hold_next_to_nothing_to_go() -> None:
    near, edge = bars(2.5 * R, 0.3), np.array([[8, 25]])
    edges = np.concatenate([near.edges, edge])
    assert left(near.points, near.nodes, edges).tolist() == near.edges.tolist()
    kept = left(near.points, near.nodes, edges, RULE._replace(between=0.0))
    assert kept.tolist() == edges.tolist()
    # Limbs whose tubes overlap are one that branches: they are never taken apart.
    close = bars(1.9 * R, 0.3)
    assert left(close.points, close.nodes, edges).tolist() == edges.tolist()


@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_units_and_the_order_of_edges_do_not_matter(unit: float) -> None:
    two = bars(2.5 * R, 0.4)
    edges = np.concatenate([two.edges, [[4, 21], [12, 29]]])
    mass = np.full(len(two.points), 3.0)
    radius = np.full(len(two.nodes), unit * R)
    order = np.random.default_rng(0).permutation(len(edges))
    found = untied(unit * two.points, mass, unit * two.nodes, radius, edges[order], RULE)
    wanted = left(two.points, two.nodes, edges)
    assert len(wanted) < len(edges)
    assert sorted(found.tolist()) == sorted(wanted.tolist())


def test_a_graph_without_edges_has_no_ties() -> None:
    none = np.empty((0, 2), np.int64)
    assert left(np.zeros((3, 3)), np.zeros((2, 3)), none).shape == (0, 2)


# --- the stage


def tied() -> tuple[PointCloud, RoughSkeleton, Surface, Surface, IntArray]:
    """Return noisy bars with a tie, their surface as it is seen and levelled, and their edges."""
    two = bars(2.5 * R, 0.4)
    cloud = Density()(PointCloud(two.points)).cloud
    nodes = cloud.unit.to_unit(two.nodes)
    count, radius = len(nodes), R / cloud.unit.length
    edges = np.concatenate([two.edges, [[4, 21], [12, 29]]])
    placed = Nodes(
        nodes,
        mass=np.full(count, 1.0 / count),
        scale=np.full(count, radius),
        header=cloud.header,
    )
    plan = Transport(max_steps=0, marginals="free", epsilon=0.01)(cloud, placed).plan
    seen = SurfaceGraph()(cloud).surface
    side = two.points[:, 1] > 1.25 * R
    axis = cloud.unit.to_unit(two.points * X + np.array([0, 2.5 * R, 0]) * side[:, None])
    ridges = Ridges(axis, np.tile(X, (len(axis), 1)), np.full(len(axis), radius))
    level = replace(seen, positions=levelled(cloud.positions, ridges))
    return cloud, RoughSkeleton(plan, edges, np.ones(count, dtype=bool)), seen, level, two.edges


def test_the_stage_takes_ties_out_where_the_surface_was_levelled() -> None:
    cloud, rough, seen, level, wanted = tied()
    assert Untie()(cloud, rough, seen).rough is rough
    assert Untie(noise=0.6)(cloud, rough, level).rough is rough
    found = Untie()(cloud, rough, level).rough
    assert found.edges.tolist() == wanted.tolist()
    assert found.plan is rough.plan
    assert len(rough.edges) == len(wanted) + 2


def test_what_surrounds_an_update_is_not_untied() -> None:
    cloud, rough, _, level, _ = tied()
    fixed = np.zeros(len(rough.nodes), dtype=bool)
    fixed[0] = True
    plan = replace(rough.plan, nodes=replace(rough.nodes, fixed=fixed))
    held = replace(rough, plan=plan)
    assert Untie()(cloud, held, level).rough is held
