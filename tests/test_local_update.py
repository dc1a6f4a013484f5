"""What makes an update local: fixed nodes, links around them, and seeds where none stands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapes
from scipy import sparse

from mdcs_pipeline.errors import InputError
from mdcs_pipeline.kernels.bends import steps_in_radii, without
from mdcs_pipeline.kernels.compiled.cheapest import cheapest_site
from mdcs_pipeline.kernels.fallen import fallen_apart
from mdcs_pipeline.kernels.merging import close_pairs
from mdcs_pipeline.kernels.optimise import Descent, optimise
from mdcs_pipeline.kernels.problem import Accuracy, Problem
from mdcs_pipeline.messages import (
    Header,
    Known,
    MassCloud,
    Nodes,
    RoughSkeleton,
    Surface,
    Thickness,
    TransportPlan,
    UnitFrame,
)
from mdcs_pipeline.scene.region import Region
from mdcs_pipeline.stages.link import Link
from mdcs_pipeline.stages.merge import Merge
from mdcs_pipeline.stages.newborn import Newborn
from mdcs_pipeline.stages.prune import Prune
from mdcs_pipeline.stages.recall import Recall
from mdcs_pipeline.stages.surface import SurfaceGraph
from mdcs_pipeline.stages.thickness import LocalThickness
from mdcs_pipeline.stages.transport import Transport

UNIT = UnitFrame(np.zeros(3), np.eye(3), 1.0)


def rod_cloud(count: int = 800) -> MassCloud:
    points = shapes.cylinder(count)
    return MassCloud(points, np.full(len(points), 1.0 / len(points)), UNIT)


@pytest.mark.parametrize("free", [True, False])
def test_fixed_nodes_stay_to_the_bit_and_the_others_move(free: bool) -> None:
    points = shapes.cylinder(600)
    ones = np.ones(len(points))
    nodes = np.stack([np.linspace(-0.9, 0.9, 7), np.full(7, 0.1), np.zeros(7)], axis=1)
    fixed = np.arange(7) % 3 == 0
    problem = Problem(points, ones / len(ones), nodes, np.full(7, 1 / 7), 0.02, ones, np.ones(7))
    edges = np.stack([np.arange(6), np.arange(1, 7)], axis=1)
    descent = Descent(2, 1.0, 5, 0.0, free, 0.0 if free else 0.3)
    bends = without(steps_in_radii(edges, problem.node_scale), fixed)
    found = optimise(problem, np.zeros(7), Accuracy(), descent, bends, fixed)
    np.testing.assert_array_equal(found.problem.nodes[fixed], nodes[fixed])
    assert np.abs(found.problem.nodes[~fixed, 1]).max() < 0.05


def test_of_two_fixed_nodes_neither_merges_and_a_fixed_one_takes_others_in() -> None:
    nodes = np.array([[0.0, 0, 0], [0.1, 0, 0], [1.0, 0, 0], [1.1, 0, 0], [2.0, 0, 0], [2.1, 0, 0]])
    fixed = np.array([True, True, False, True, False, False])
    pairs = close_pairs(nodes, np.ones(6), 0.5, fixed)
    assert sorted(map(tuple, pairs.tolist())) == [(3, 2), (4, 5)]


def test_what_stands_merges_only_when_closer() -> None:
    nodes = np.array([[0.0, 0, 0], [0.9, 0, 0], [5.0, 0, 0], [5.9, 0, 0]])
    widths = np.array([0.8, 0.8, 0.8, 1.0])
    pairs = close_pairs(nodes, np.ones(4), 1.0, None, widths)
    assert pairs.tolist() == [[2, 3]]


def transported(nodes: Nodes) -> tuple[MassCloud, TransportPlan]:
    cloud = rod_cloud()
    surface = SurfaceGraph()(cloud).surface
    thickness = LocalThickness(landmarks=50)(cloud, surface).thickness
    stage = Transport(epsilon=2.1, theta=1.0, max_steps=3, marginals="free", cut=0.001)
    return cloud, stage(cloud, nodes, thickness).plan


def test_a_merge_into_a_fixed_node_leaves_it_as_it_is() -> None:
    places = np.array([[-0.5, 0, 0], [-0.45, 0, 0], [0.4, 0, 0]])
    fixed = np.array([True, False, False])
    nodes = Nodes(places, np.full(3, 1 / 3), scale=np.full(3, 0.15), fixed=fixed)
    _, plan = transported(nodes)
    merged = Merge(rule="spacing", spacing=4.0)(plan).unsettled
    assert merged is not None
    np.testing.assert_array_equal(merged.positions[0], places[0])
    assert merged.scale[0] == 0.15
    assert merged.fixed[0]
    assert np.isclose(merged.mass.sum(), 1.0)


def line(fixed: list[bool], beyond: list[int], links: list[list[int]]) -> Nodes:
    places = np.stack([np.linspace(-0.85, 0.85, 6), np.zeros(6), np.zeros(6)], axis=1)
    return Nodes(
        places,
        np.full(6, 1 / 6),
        scale=np.full(6, 0.15),
        fixed=np.array(fixed),
        beyond=np.array(beyond),
        links=np.array(links, dtype=np.int64).reshape(-1, 2),
    )


def linked(nodes: Nodes) -> set[tuple[int, ...]]:
    cloud, plan = transported(nodes)
    surface = SurfaceGraph()(cloud).surface
    link = Link(rule="co_transport", widening=1.0, strength=0.01, joining=0.0001)
    return set(map(tuple, link(cloud, plan, surface).rough.edges.tolist()))


def test_edges_between_fixed_nodes_are_those_that_were_there() -> None:
    """Here the update would join 0 and 1; but it is not asked about them."""
    free = linked(line([False] * 6, [-1] * 6, []))
    assert free == {(k, k + 1) for k in range(5)}
    kept = linked(line([True, True] + [False] * 4, [0, 0, -1, -1, -1, -1], []))
    assert kept == free - {(0, 1)}
    other = linked(line([True, True] + [False] * 4, [-1] * 6, [[0, 1]]))
    assert other == free


def test_ways_outside_are_no_edges() -> None:
    nodes = line([True, True, False, False, False, True], [3, 3, -1, -1, -1, 3], [])
    assert not linked(nodes) & {(0, 1), (0, 5), (1, 5)}


def test_the_nearest_node_is_that_of_least_cost() -> None:
    points = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    nodes = np.array([[0.2, 0, 0], [2.0, 0, 0]])
    nearest, cost = cheapest_site(points, np.ones(2), nodes, np.array([0.1, 2.0]))
    assert nearest.tolist() == [0, 1]
    np.testing.assert_allclose(cost, [0.04 / 0.1, 1.0 / 2.0])


def chain(pairs: list[tuple[int, int]], count: int) -> sparse.csr_array:
    rows = np.array([p for pair in pairs for p in pair])
    columns = np.array([p for i, j in pairs for p in (j, i)])
    return sparse.csr_array(
        sparse.coo_array((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    )


def test_the_lesser_piece_of_a_node_has_fallen_off() -> None:
    graph = chain([(0, 1), (1, 2), (3, 4), (5, 6), (6, 7), (2, 5)], 9)
    owner = np.array([0, 0, 0, 0, 0, 1, 1, 1, -1])
    # 0 owns 0-1-2 and, apart from these, 3-4; the tie between 2 and 5 crosses owners.
    assert np.flatnonzero(fallen_apart(graph, owner, 0.25)).tolist() == [3, 4]
    assert not fallen_apart(graph, owner, 0.5).any()
    assert not fallen_apart(graph, np.full(9, -1), 0.1).any()


def test_nodes_hold_what_an_update_needs_through_a_merge() -> None:
    nodes = line([True] + [False] * 5, [7] + [-1] * 5, [])
    _, plan = transported(replace(nodes, mass=np.full(6, 1 / 6)))
    merged = Merge(rule="spacing", spacing=3.0)(plan).unsettled
    assert merged is not None
    assert merged.fixed.tolist()[0]
    assert merged.beyond.tolist()[0] == 7
    assert (merged.beyond[1:] == -1).all()


def spurred(fixed: list[bool]) -> tuple[MassCloud, RoughSkeleton]:
    """Return a rod with a node beside its middle: a spur."""
    places = np.array([[-0.8, 0, 0], [0.0, 0, 0], [0.8, 0, 0], [0.0, 0.02, 0]])
    nodes = Nodes(places, np.full(4, 1 / 4), scale=np.full(4, 0.5), fixed=np.array(fixed))
    cloud = rod_cloud()
    owner = np.argmin(np.linalg.norm(cloud.positions[:, None] - places, axis=2), axis=1)
    entries = (cloud.mass, (np.arange(len(cloud)), owner))
    plan = TransportPlan(
        plan=sparse.csr_array(entries, shape=(len(cloud), 4)),
        nodes=nodes,
        point_potentials=np.zeros(len(cloud)),
        epsilon=1.0,
        iterations=1,
        marginal_error=0.0,
        converged=True,
        warm=False,
    )
    edges = np.array([[0, 1], [1, 2], [1, 3]])
    return cloud, RoughSkeleton(plan, edges, np.ones(4, dtype=bool))


def test_a_free_spur_goes_and_its_fixed_junction_stays_to_the_bit() -> None:
    cloud, rough = spurred([False, True, False, False])
    nodes = Prune(cover=0.0)(cloud, rough).rough.nodes
    assert nodes.ids.tolist() == rough.nodes.ids[:3].tolist()
    np.testing.assert_array_equal(nodes.positions[1], rough.nodes.positions[1])
    assert nodes.scale[1] == rough.nodes.scale[1]
    free = Prune(cover=0.0)(*spurred([False] * 4)).rough.nodes
    assert len(free) == 3
    assert free.positions[1, 1] > 0.0


def test_a_fixed_spur_is_not_an_updates_to_shed() -> None:
    """It may be a limb that goes on outside; pruning knew of no fixed nodes before."""
    cloud, rough = spurred([False, False, False, True])
    assert len(Prune(cover=0.0)(cloud, rough).rough.nodes) == 4


def rod_region(places: np.ndarray, **given: np.ndarray) -> Region:
    """Return the region of a straight rod of radius 0.1 about the x-axis, all of it known."""
    count, none = len(places), np.empty(0, np.int64)
    normal = places * [0.0, 10.0, 10.0]
    values = {
        "slots": np.arange(count),
        "taken": np.ones(count, bool),
        "owner": np.full(count, 7),
        "radius": np.full(count, 0.1),
        "middle": places - 0.1 * normal,
        "trust": np.ones(count),
        "normal": normal,
        "changed": np.zeros(count, bool),
        "grown": none,
        "active": np.array([7]),
        "ring": none,
        **given,
    }
    return Region(header=Header(), next_id=8, figures={}, **values)


def rod(count: int = 2000) -> tuple[np.ndarray, MassCloud]:
    rng = np.random.default_rng(0)
    angle, along = rng.uniform(0, 2 * np.pi, count), np.sort(rng.uniform(0, 2, count))
    places = np.column_stack([along, 0.1 * np.cos(angle), 0.1 * np.sin(angle)])
    return places, MassCloud(places, np.full(count, 1 / count), UNIT)


def test_recall_asks_where_the_surface_around_is_new() -> None:
    places, cloud = rod()
    changed = places[:, 0] < 1.0
    region = rod_region(places, changed=changed)
    known = Recall()(cloud, region).known
    assert known.asked[changed].all()
    # A ball of 1.3 radii reaches 0.083 along a rod of radius 0.1.
    assert known.asked[~changed & (places[:, 0] < 1.03)].all()
    assert not known.asked[places[:, 0] > 1.09].any()
    rest = ~known.asked
    np.testing.assert_array_equal(known.radius[rest], region.radius[rest])
    np.testing.assert_array_equal(known.middle[rest], region.middle[rest])
    np.testing.assert_array_equal(known.normal[rest], region.normal[rest])


def test_recall_looks_across_the_limb() -> None:
    """What faces new surface over its middle is measured again, however far along the surface."""
    places, cloud = rod()
    known = Recall()(cloud, rod_region(places, changed=places[:, 1] > 0)).known
    assert known.asked.all()


def test_trust_fades_with_every_change_until_a_point_is_measured_again() -> None:
    places, cloud = rod()
    far = places[:, 0] > 1.5
    region = rod_region(places, changed=np.arange(2000) % 25 == 0)
    rounds = 0
    while not (known := Recall(sure=0.9)(cloud, region).known).asked[far].mean() > 0.9:
        assert (known.trust[~known.asked] <= region.trust[~known.asked]).all()
        region = replace(region, trust=known.trust)
        rounds += 1
        assert rounds < 10
    assert rounds >= 1


def test_recall_asks_for_what_is_new_or_was_not_sure_but_not_beyond_the_update() -> None:
    places, cloud = rod(600)
    kind = np.arange(600) % 4
    region = rod_region(
        places,
        radius=np.where(kind == 0, 0.0, 0.1),
        trust=np.where(kind <= 2, 0.4, 1.0),
        taken=kind != 2,
    )
    known = Recall()(cloud, region).known
    np.testing.assert_array_equal(known.asked, kind < 2)


def test_known_points_need_a_radius() -> None:
    with pytest.raises(InputError, match="positive"):
        Known(np.zeros(2, bool), np.array([1.0, 0.0]), *np.zeros((1, 2, 3)), *np.zeros((1, 2)),
              np.zeros((2, 3)))  # fmt: skip


@pytest.mark.parametrize(("forsaken", "grown_on"), [(2.5, True), (100.0, False)])
def test_points_far_from_the_node_that_owns_them_are_seeded_anew(
    forsaken: float, grown_on: bool
) -> None:
    # A limb that was shed to node 7 while it was short, and is ten radii long by now.
    along = np.linspace(0.0, 1.0, 101)
    places = np.column_stack([along, np.zeros((101, 2))])
    cloud = MassCloud(places, np.full(101, 1.0 / 101), UNIT)
    region = rod_region(places)
    near = sparse.csr_array(sparse.diags_array([np.full(100, 0.01)] * 2, offsets=[-1, 1]))
    found = Newborn(forsaken=forsaken)(
        cloud,
        region,
        Surface(places, near),
        Thickness(np.full(101, 0.1), np.ones(101)),
        Nodes(np.zeros((1, 3)), np.ones(1), scale=np.array([0.1]), ids=np.array([7])),
    ).nodes
    assert found.ids[0] == 7
    assert bool(len(found) > 1) is grown_on
    assert (found.positions[1:, 0] >= 0.25 - 1e-9).all()
