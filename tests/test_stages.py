"""What each stage does, on its own and without a pipeline around it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import shapes
from scipy import sparse
from scipy.spatial.distance import cdist

from mdcs_pipeline.errors import InputError, OutputError
from mdcs_pipeline.kernels.assignment import plan_owners
from mdcs_pipeline.messages import (
    Header,
    MassCloud,
    Nodes,
    PointCloud,
    RoughSkeleton,
    Skeleton,
    Surface,
    Thickness,
    TransportPlan,
    UnitFrame,
)
from mdcs_pipeline.stages.check import Check
from mdcs_pipeline.stages.clean import Clean
from mdcs_pipeline.stages.combine import Combine
from mdcs_pipeline.stages.density import Density
from mdcs_pipeline.stages.downsample import Downsample
from mdcs_pipeline.stages.link import Link
from mdcs_pipeline.stages.merge import Merge
from mdcs_pipeline.stages.read import Read
from mdcs_pipeline.stages.seed import Seed
from mdcs_pipeline.stages.smooth import Smooth
from mdcs_pipeline.stages.surface import SurfaceGraph
from mdcs_pipeline.stages.thickness import LocalThickness
from mdcs_pipeline.stages.transport import Transport
from mdcs_pipeline.stages.write import Write

HEADER = Header("map", 5, 2)


class Rod(NamedTuple):
    """A cylinder along x on its way through the first stages."""

    points: PointCloud
    cloud: MassCloud
    surface: Surface
    thickness: Thickness


def measured(points: np.ndarray) -> Rod:
    cloud = PointCloud(points, header=HEADER)
    mass = Density()(cloud).cloud
    surface = SurfaceGraph()(mass).surface
    return Rod(cloud, mass, surface, LocalThickness()(mass, surface).thickness)


@pytest.fixture(scope="module")
def rod() -> Rod:
    return measured(shapes.cylinder(1200, 0))


def typical_radii(rods: list[np.ndarray], **settings: int) -> np.ndarray:
    cloud = Density()(PointCloud(np.concatenate(rods))).cloud
    surface = SurfaceGraph()(cloud).surface
    found = LocalThickness(landmarks=8, **settings)(cloud, surface).thickness
    return np.median((found.radius * cloud.unit.length).reshape(len(rods), -1), axis=1)


def test_each_object_of_a_large_scene_has_its_own_thickness():
    """Fewer landmarks than objects would give all of them the radius of a few."""
    rod = shapes.cylinder(600, 0)
    thick, thin = rod, rod * [1.0, 1 / 3, 1 / 3]
    scene = [(thin if k % 2 else thick) + [0.0, 2.0 * k, 0.0] for k in range(20)]
    alone = np.tile(np.concatenate([typical_radii([thick]), typical_radii([thin])]), 10)
    assert np.abs(typical_radii(scene) / alone - 1.0).max() < 0.15
    assert np.abs(typical_radii(scene, share=100_000) / alone - 1.0).max() > 0.5


def nodes_at(cloud: MassCloud, places: np.ndarray, **values: object) -> Nodes:
    count = len(places)
    given = {"mass": np.full(count, 1 / count), "header": cloud.header, **values}
    return Nodes(np.asarray(places, np.float64), **given)  # type: ignore[arg-type]


def plan_to(cloud: MassCloud, places: np.ndarray, **values: object) -> TransportPlan:
    """Return the plan to nodes that stay where they are put."""
    stage = Transport(max_steps=0, marginals="free", epsilon=0.005)
    return stage(cloud, nodes_at(cloud, places, **values)).plan


# --- downsample, clean, combine


def test_downsample_keeps_total_weight_and_centroid() -> None:
    points, weights = shapes.y(2000, 0), np.random.default_rng(0).uniform(0.5, 3, 1626)
    points = points[: len(weights)]
    weights = weights[: len(points)]
    cloud = PointCloud(points, weights, HEADER, dropped=4)
    for voxel in (1e-6, 0.02, 0.5):
        found = Downsample(voxel=voxel)(cloud).cloud
        assert found.weights is not None
        assert found.weights.sum() == pytest.approx(weights.sum(), rel=1e-12)
        np.testing.assert_allclose(
            found.weights @ found.positions / found.weights.sum(),
            weights @ points / weights.sum(),
            atol=1e-12,
        )
        assert (found.header, found.dropped) == (HEADER, 4)
    assert len(Downsample(voxel=1e-6)(cloud).cloud) == len(points)
    assert len(found) < 30


def test_a_voxel_can_be_given_in_input_units() -> None:
    cloud = PointCloud(shapes.cylinder(3000, 0) * 100)
    found = Downsample(voxel_size=10.0)(cloud).cloud
    same = Downsample(voxel_size=0.1)(PointCloud(cloud.positions / 100)).cloud
    np.testing.assert_allclose(found.positions / 100, same.positions, atol=1e-9)
    # A rod of length 230 and radius 15 has a skin of about 20 voxels around and 23 along.
    assert 200 < len(found) < 700


def test_voxels_beyond_counting_are_refused() -> None:
    with pytest.raises(InputError, match="spans more than") as caught:
        Downsample(voxel=1e-9)(PointCloud(shapes.ball(100)))
    assert "larger voxel" in str(caught.value)


@pytest.mark.parametrize("stage", [Downsample(), Density()])
@pytest.mark.parametrize(
    ("points", "said"),
    [
        (np.empty((0, 3)), "the cloud is empty"),
        (np.full((9, 3), 2.5), "all points coincide"),
        (shapes.ball(50) * 1e145, "size must lie between"),
        (shapes.ball(50) * 1e-145, "size must lie between"),
    ],
)
def test_clouds_without_a_frame_are_refused(
    stage: Downsample | Density, points: np.ndarray, said: str
) -> None:
    with pytest.raises(InputError, match=said):
        stage(PointCloud(points))


def test_clean_drops_strays_and_keeps_their_weights_apart() -> None:
    points = shapes.y(2000, 0)
    stray = np.array([[3.0, 3, 3], [-4, 2, 0], [0, -5, 2]])
    weights = np.concatenate([np.ones(len(points)), np.full(3, 9.0)])
    cloud = PointCloud(np.concatenate([points, stray]), weights, HEADER, dropped=1)
    found = Clean()(cloud).cloud
    assert found.weights is not None
    assert found.weights.max() == 1.0
    assert len(found) > 0.97 * len(points)
    assert (found.header, found.dropped) == (HEADER, 1)


def test_clean_drops_specks_only_where_it_is_asked_to() -> None:
    points = shapes.y(3000, 0)
    speck = np.array([2.0, 2, 2]) + 0.02 * shapes.ball(9)
    cloud = PointCloud(np.concatenate([points, speck]))

    def left(**settings: float) -> int:
        kept = Clean(passes=0, **settings)(cloud).cloud.positions
        return int((kept[:, 2] > 1.5).sum())

    assert left() == 0
    assert left(least_island=0.0) == len(speck)


def test_clean_leaves_small_clouds_alone() -> None:
    cloud = PointCloud(np.vstack([shapes.ball(12), [[90, 0, 0]]]))
    np.testing.assert_array_equal(Clean()(cloud).cloud.positions, cloud.positions)


def test_combine_joins_in_order_with_the_newest_header() -> None:
    one = PointCloud(shapes.ball(5), header=Header("map", 10, 1), dropped=2)
    two = PointCloud(shapes.ball(4) + 3, np.full(4, 2.0), Header("map", 30, 0), dropped=1)
    found = Combine()((one, two, one)).cloud
    np.testing.assert_array_equal(
        found.positions, np.concatenate([one.positions, two.positions, one.positions])
    )
    assert found.weights is not None
    assert found.weights.tolist() == [1.0] * 5 + [2.0] * 4 + [1.0] * 5
    assert (found.header, found.dropped) == (two.header, 5)
    assert Combine()((one, one)).cloud.weights is None


def test_combine_refuses_two_frames() -> None:
    clouds = tuple(PointCloud(shapes.ball(5), header=Header(name)) for name in ("map", "base"))
    with pytest.raises(InputError, match="different frames") as caught:
        Combine()(clouds)
    assert caught.value.received == "base, map"


# --- density, surface, thickness


def test_density_levels_uneven_sampling() -> None:
    """One half of a rod has five times the points: by area, both halves still weigh the same."""
    points = shapes.cylinder(4000, 0)
    thinned = points[(points[:, 0] > 0) | (np.arange(len(points)) % 5 == 0)]

    def right(**settings: str) -> float:
        found = Density(**settings)(PointCloud(thinned)).cloud
        side = found.unit.from_unit(found.positions)[:, 0] > 0
        return float(found.mass[side].sum())

    assert right() == pytest.approx(0.5, abs=0.05)
    assert right(mass="count") == pytest.approx(5 / 6, abs=0.03)


def test_mass_by_count_follows_the_weights() -> None:
    weights = np.arange(1.0, 51)
    found = Density(mass="count")(PointCloud(shapes.ball(50), weights)).cloud
    np.testing.assert_allclose(found.mass, weights / weights.sum())


def test_density_asks_for_four_points() -> None:
    with pytest.raises(InputError, match="at least 4 points"):
        Density()(PointCloud(np.eye(3)))
    assert len(Density()(PointCloud(np.vstack([np.eye(3), np.zeros(3)]))).cloud) == 4


def test_the_surface_graph_is_symmetric_and_of_distances(rod: Rod) -> None:
    graph = rod.surface.graph
    assert abs(graph - graph.T).max() == 0
    i, j = graph.nonzero()
    places = rod.surface.positions
    np.testing.assert_allclose(graph[i, j], np.linalg.norm(places[i] - places[j], axis=1))
    assert np.diff(graph.indptr).min() >= 8


def test_averaging_takes_noise_off_a_plane() -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(0, 1, (900, 2)), rng.normal(scale=0.02, size=900)])
    unit = UnitFrame(np.zeros(3), np.eye(3), 1.0)
    cloud = MassCloud(points, np.full(900, 1 / 900), unit)
    plain, smooth = (SurfaceGraph(averaging=k)(cloud).surface.positions for k in (0, 12))
    np.testing.assert_array_equal(plain, points)
    assert smooth[:, 2].std() < 0.5 * points[:, 2].std()


def test_thickness_is_the_radius_of_a_rod_at_any_scale() -> None:
    for width in (1.0, 1.6):
        made = measured(shapes.cylinder(1500, 1) * [1, width, width])
        radius = np.median(made.thickness.radius) * made.cloud.unit.length
        assert radius == pytest.approx(0.15 * width, rel=0.2)
        assert made.thickness.confidence.max() <= 1.0


# --- seed, transport, merge


def test_seed_takes_points_of_equal_mass(rod: Rod) -> None:
    found = Seed(ratio=0.05)(rod.cloud, rod.thickness).nodes
    assert len(found) == 60
    np.testing.assert_allclose(found.mass, 1 / 60)
    match = (found.positions[:, None] == rod.cloud.positions).all(axis=2)
    assert match.any(axis=1).all()
    np.testing.assert_array_equal(found.scale, rod.thickness.radius[match.argmax(axis=1)])
    assert Seed()(rod.cloud).nodes.scale.max() == 1.0
    assert not found.settled.any()


def test_seed_counts(rod: Rod) -> None:
    assert len(Seed(ratio=1e-6, least=11)(rod.cloud).nodes) == 11
    assert len(Seed(ratio=1.0)(rod.cloud).nodes) == len(rod.cloud)
    few = Density()(PointCloud(shapes.ball(5))).cloud
    assert len(Seed(least=50)(few).nodes) == 5


@pytest.mark.parametrize("choice", ["random", "spread"])
def test_seed_depends_on_its_seed_alone(rod: Rod, choice: str) -> None:
    places = [Seed(choice=choice, seed=s)(rod.cloud).nodes.positions for s in (3, 3, 4)]
    np.testing.assert_array_equal(places[0], places[1])
    assert not np.array_equal(places[0], places[2])
    assert len(np.unique(places[0], axis=0)) == len(places[0])


def test_spread_candidates_lie_farther_apart(rod: Rod) -> None:
    def nearest(choice: str) -> float:
        places = Seed(choice=choice)(rod.cloud).nodes.positions
        gaps = np.linalg.norm(places[:, None] - places, axis=2)
        return float((gaps + np.eye(len(places)) * 9).min())

    assert nearest("spread") > 3 * nearest("random")


def test_balanced_transport_serves_each_node_with_its_mass(rod: Rod) -> None:
    nodes = Seed()(rod.cloud).nodes
    found = Transport(tolerance=1e-4, max_steps=5)(rod.cloud, nodes).plan
    received = np.asarray(found.plan.sum(axis=0)).ravel()
    assert found.converged
    assert np.abs(received - nodes.mass).sum() <= 1.1e-4
    np.testing.assert_array_equal(found.nodes.mass, nodes.mass)
    assert found.epsilon == 0.001
    assert not found.warm
    assert np.diff(found.energy).max() <= 1e-9
    assert len(found.energy) == 6


def test_free_transport_gives_nodes_the_mass_that_comes(rod: Rod) -> None:
    nodes = Seed()(rod.cloud).nodes
    found = Transport(marginals="free", max_steps=2, precision="double")(rod.cloud, nodes).plan
    np.testing.assert_allclose(found.nodes.mass, np.asarray(found.plan.sum(axis=0)).ravel())
    assert not np.allclose(found.nodes.mass, nodes.mass)


def test_without_steps_nodes_stay(rod: Rod) -> None:
    nodes = Seed()(rod.cloud).nodes
    found = Transport(max_steps=0)(rod.cloud, nodes).plan
    np.testing.assert_array_equal(found.nodes.positions, nodes.positions)
    moved = Transport(max_steps=3)(rod.cloud, nodes).plan.nodes.positions
    assert not np.allclose(moved, nodes.positions)


def test_transport_takes_the_nodes_epsilon_and_starts_warm_from_theirs(rod: Rod) -> None:
    first = Transport(max_steps=0)(rod.cloud, Seed()(rod.cloud).nodes).plan
    again = Transport(max_steps=0, epsilon=9.0)(rod.cloud, first.nodes).plan
    assert again.epsilon == first.epsilon == 0.001
    assert again.warm
    assert again.iterations < first.iterations
    assert abs(again.plan - first.plan).sum() < 2e-3


def test_transport_over_a_thickness_gives_nodes_the_scale_of_their_points(rod: Rod) -> None:
    nodes = Seed()(rod.cloud, rod.thickness).nodes
    found = Transport(epsilon=1.0)(rod.cloud, nodes, rod.thickness)
    assert found.thickness is rod.thickness
    scale = found.plan.nodes.scale
    assert scale.min() >= rod.thickness.radius.min()
    assert scale.max() <= rod.thickness.radius.max()
    assert Transport()(rod.cloud, nodes).thickness is None


def axis_places(cloud: MassCloud, count: int) -> np.ndarray:
    """Return places on the axis of a rod, which is the first of its frame."""
    reach = 0.9 * np.abs(cloud.positions[:, 0]).max()
    return np.column_stack([np.linspace(-reach, reach, count), np.zeros((count, 2))])


def test_merge_by_spacing_halves_what_is_closer_than_its_radius(rod: Rod) -> None:
    places = np.repeat(axis_places(rod.cloud, 4), 2, axis=0)
    places[1::2, 0] += 0.01
    plan = plan_to(rod.cloud, places, scale=np.full(8, 0.05))
    merged, kept = Merge(rule="spacing")(plan)
    assert merged is not None
    assert len(merged) == 4
    np.testing.assert_allclose(merged.mass, plan.nodes.mass.reshape(4, 2).sum(axis=1))
    assert set(merged.ids.tolist()) < set(plan.nodes.ids.tolist())
    assert not kept.nodes.settled.any()
    np.testing.assert_array_equal(kept.plan.data, plan.plan.data)


def test_merge_by_spacing_leaves_what_is_far_apart(rod: Rod) -> None:
    plan = plan_to(rod.cloud, axis_places(rod.cloud, 5), scale=np.full(5, 0.01))
    merged, kept = Merge(rule="spacing")(plan)
    assert merged is None
    assert kept.nodes.settled.all()


def test_merge_by_lines_labels_a_chain_on_the_axis(rod: Rod) -> None:
    """Nodes on the axis share each point between two: they are the skeleton already."""
    merged, kept = Merge()(plan_to(rod.cloud, axis_places(rod.cloud, 6)))
    assert merged is None
    assert kept.nodes.settled.all()
    assert kept.nodes.links.tolist() == [[i, i + 1] for i in range(5)]


def test_merge_by_lines_takes_nodes_on_the_wall_together(rod: Rod) -> None:
    plan = plan_to(rod.cloud, Seed()(rod.cloud).nodes.positions)
    merged, kept = Merge()(plan)
    assert merged is not None
    assert len(merged) < len(plan.nodes)
    assert merged.mass.sum() == pytest.approx(1, abs=1e-12)
    assert len(kept.nodes) == len(plan.nodes)
    assert (merged.links < len(merged)).all()


# --- link and check


def test_link_keeps_the_connections_of_merging(rod: Rod) -> None:
    plan = Merge()(plan_to(rod.cloud, axis_places(rod.cloud, 6))).plan
    found = Link()(rod.cloud, plan).rough
    np.testing.assert_array_equal(found.edges, plan.nodes.links)
    np.testing.assert_array_equal(found.skeletal, plan.nodes.settled)


@pytest.mark.parametrize("on_surface", [True, False])
def test_link_by_shared_mass_finds_a_chain(rod: Rod, on_surface: bool) -> None:
    plan = plan_to(rod.cloud, axis_places(rod.cloud, 6))
    surface = rod.surface if on_surface else None
    found = Link(rule="co_transport", strength=0.01)(rod.cloud, plan, surface).rough
    assert found.edges.tolist() == [[i, i + 1] for i in range(5)]


def test_link_joins_what_is_close_through_air_only_without_a_surface() -> None:
    """Two parallel bars, a node on each: they share mass, but no surface."""
    bars = measured(shapes.two_bars(1500, 0) * [0.3, 0.3, 1])
    side = bars.cloud.unit.from_unit(bars.cloud.positions)[:, 1] > 0
    places = [bars.cloud.positions[side == k].mean(axis=0) for k in (False, True)]
    stage = Transport(max_steps=0, marginals="free", epsilon=0.2)
    plan = stage(bars.cloud, nodes_at(bars.cloud, np.array(places))).plan
    link = Link(rule="co_transport", strength=0.01)
    assert link(bars.cloud, plan).rough.edges.tolist() == [[0, 1]]
    assert link(bars.cloud, plan, bars.surface).rough.edges.tolist() == []


def test_pieces_are_not_joined_over_a_stray_contact() -> None:
    """Bars as above, of four nodes each, whose surfaces one link joins, as noise does."""
    bars = measured(shapes.two_bars(1500, 0) * [0.3, 0.3, 1])
    points = bars.cloud.positions
    side = bars.cloud.unit.from_unit(points)[:, 1] > 0
    part = np.digitize(points[:, 2], np.quantile(points[:, 2], [0.25, 0.5, 0.75]))
    places = [points[(side == k) & (part == q)].mean(0) for k in (False, True) for q in range(4)]
    stage = Transport(max_steps=0, marginals="free", epsilon=0.2)
    plan = stage(bars.cloud, nodes_at(bars.cloud, np.array(places))).plan
    one, other = np.flatnonzero(~side), np.flatnonzero(side)
    apart = cdist(points[one], points[other])
    i, j = np.unravel_index(apart.argmin(), apart.shape)
    stray = sparse.coo_array(
        (np.full(2, apart[i, j]), ([one[i], other[j]], [other[j], one[i]])),
        shape=bars.surface.graph.shape,
    )
    surface = replace(bars.surface, graph=sparse.csr_array(bars.surface.graph + stray))
    rules = {"rule": "co_transport", "strength": 0.1, "joining": 0.0001}
    apart_bars = [[0, 1], [1, 2], [2, 3], [4, 5], [5, 6], [6, 7]]
    joined = Link(**rules)(bars.cloud, plan, surface).rough.edges.tolist()
    assert len(joined) == 7
    firm = Link(**rules, joining_contact=0.15)(bars.cloud, plan, surface).rough.edges.tolist()
    assert firm == apart_bars


def test_an_end_goes_on_over_any_contact(rod: Rod) -> None:
    """A rod with a gap that a single link of the surface leads over."""
    plan = plan_to(rod.cloud, axis_places(rod.cloud, 6))
    x = rod.cloud.positions[:, 0]
    links = rod.surface.graph.tocoo()
    over = np.flatnonzero((x[links.row] < 0) & (x[links.col] >= 0))[:1]
    kept = (x[links.row] < 0) == (x[links.col] < 0)
    rows = np.concatenate([links.row[kept], links.row[over], links.col[over]])
    cols = np.concatenate([links.col[kept], links.col[over], links.row[over]])
    lengths = np.concatenate([links.data[kept], links.data[over], links.data[over]])
    graph = sparse.csr_array((lengths, (rows, cols)), shape=links.shape)
    surface = replace(rod.surface, graph=graph)
    rules = {"rule": "co_transport", "contact": 0.3, "strength": 0.01, "joining_contact": 0.3}
    found = Link(**rules)(rod.cloud, plan, surface).rough
    assert found.edges.tolist() == [[i, i + 1] for i in range(5)]


@pytest.mark.parametrize(("onward", "joined"), [(0.7, True), (1.0, False)])
def test_ends_that_face_each_other_need_no_touch(rod: Rod, onward: float, joined: bool) -> None:
    """A rod with a gap that no link of the surface leads over, and its nodes a little aslant."""
    places = axis_places(rod.cloud, 6)
    places[3, 1] += 0.1 * (places[3, 0] - places[2, 0])
    plan = plan_to(rod.cloud, places)
    left, links = plan_owners(plan.plan) < 3, rod.surface.graph.tocoo()
    kept = left[links.row] == left[links.col]
    graph = sparse.csr_array(
        (links.data[kept], (links.row[kept], links.col[kept])), shape=links.shape
    )
    rules = {"rule": "co_transport", "contact": 0.3, "strength": 0.01, "onward": onward}
    found = Link(**rules)(rod.cloud, plan, replace(rod.surface, graph=graph)).rough
    pieces = [[0, 1], [1, 2], [3, 4], [4, 5]]
    assert found.edges.tolist() == sorted(pieces + [[2, 3]] * joined)


@pytest.mark.parametrize("touching", [True, False])
def test_ends_of_one_piece_that_share_next_to_nothing_are_joined_over_a_touch(
    touching: bool,
) -> None:
    """A torus whose nodes leave a gap that hardly any mass goes to both sides of."""
    ring = measured(shapes.torus(3000))
    turn = np.append(np.linspace(0.0, 5.3, 17), 0.0)[:-1]
    middle = shapes.torus(3000).mean(axis=0)
    reach = np.linalg.norm(shapes.torus(3000)[:, :2] - middle[:2], axis=1)
    width = 0.5 * (reach.max() + reach.min())
    places = middle + width * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    plan = plan_to(ring.cloud, ring.cloud.unit.to_unit(places))
    surface = ring.surface
    if not touching:
        owner, links = plan_owners(plan.plan), ring.surface.graph.tocoo()
        ends = {int(places[:, 0].argmax()), len(places) - 1}
        apart = [set(pair) == ends for pair in zip(owner[links.row], owner[links.col], strict=True)]
        kept = ~np.array(apart)
        graph = sparse.csr_array(
            (links.data[kept], (links.row[kept], links.col[kept])), shape=links.shape
        )
        surface = replace(surface, graph=graph)
    rules = {"rule": "co_transport", "widening": 1.0, "contact": 0.3, "strength": 0.05}
    rules |= {"joining": 1e-9, "joining_contact": 0.15}
    found = Link(**rules)(ring.cloud, plan, surface).rough
    assert (np.bincount(found.edges.ravel()) == 2).all() == touching
    assert len(found.edges) == len(places) - 1 + touching


def around(rod: Rod, count: int = 6) -> RoughSkeleton:
    """Return a loop of nodes on the wall of a rod: false, as its inside is empty of loops."""
    radius = np.hypot(*rod.cloud.positions[:, 1:].T).mean()
    turn = np.arange(count) * 2 * np.pi / count
    places = np.column_stack([np.zeros(count), radius * np.cos(turn), radius * np.sin(turn)])
    plan = plan_to(rod.cloud, places, settled=np.ones(count, bool), scale=np.full(count, radius))
    edges = [[i, i + 1] for i in range(count - 1)] + [[0, count - 1]]
    return RoughSkeleton(plan, np.array(edges), np.ones(count, bool))


def test_check_by_symmetry_sends_a_loop_on_the_wall_back(rod: Rod) -> None:
    rough = around(rod)
    found = Check(epsilon_step=0.001, epsilon_max=0.01)(rod.cloud, rough)
    assert found.rejected is not None
    assert found.rejected.epsilon == pytest.approx(0.006)
    assert found.rejected.rounds == 1
    assert not found.rejected.settled.any()
    assert found.wider is None
    assert found.accepted is rough


def test_check_by_symmetry_ends_at_the_largest_epsilon(rod: Rod) -> None:
    rough = around(rod)
    assert Check(epsilon_step=0.001, epsilon_max=0.006)(rod.cloud, rough).rejected is not None
    found = Check(epsilon_step=0.001, epsilon_max=0.0054)(rod.cloud, rough)
    assert (found.rejected, found.wider) == (None, None)
    assert found.accepted is rough


def test_check_by_symmetry_accepts_a_chain_on_the_axis(rod: Rod) -> None:
    plan = Merge()(plan_to(rod.cloud, axis_places(rod.cloud, 6))).plan
    rough = Link()(rod.cloud, plan).rough
    found = Check(epsilon_max=1.0)(rod.cloud, rough)
    assert (found.rejected, found.wider) == (None, None)


def sphere_with_a_loop() -> tuple[Rod, RoughSkeleton]:
    """Return a ball with a loop of nodes on its equator, which the skin leads around."""
    ball = measured(shapes.ball(1500, 0))
    radius = np.linalg.norm(ball.cloud.positions, axis=1).mean()
    turn = np.arange(8) * np.pi / 4
    places = radius * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(8)])
    places = np.vstack([places, [[0, 0, 1.3 * radius], [0, 0, -1.3 * radius]]])
    stage = Transport(max_steps=0, marginals="free", epsilon=0.3)
    plan = stage(ball.cloud, nodes_at(ball.cloud, places, settled=np.ones(10, bool))).plan
    edges = [[i, i + 1] for i in range(7)] + [[0, 7]]
    return ball, RoughSkeleton(plan, np.array(edges), np.ones(10, bool))


def test_check_by_separation_widens_the_radius_around_a_false_loop() -> None:
    ball, rough = sphere_with_a_loop()
    stage = Check(rule="separation", widening=1.5)
    found = stage(ball.cloud, rough, ball.surface, ball.thickness)
    assert found.rejected is not None
    assert found.wider is not None
    grown = found.wider.radius / ball.thickness.radius
    assert set(np.round(grown, 9)) <= {1.0, 1.5}
    assert grown.max() == pytest.approx(1.5)
    np.testing.assert_array_equal(found.wider.confidence, ball.thickness.confidence)
    assert found.wider.trust is None
    trusted = replace(ball.thickness, trust=np.ones(len(grown)))
    again = stage(ball.cloud, rough, ball.surface, trusted).wider
    # A widened radius is no measurement.
    np.testing.assert_array_equal(again.trust, np.where(grown > 1.0, 0.0, 1.0))
    np.testing.assert_allclose(found.rejected.scale[:8], 1.5 * rough.nodes.scale[:8])
    np.testing.assert_array_equal(found.rejected.scale[8:], rough.nodes.scale[8:])
    assert found.rejected.settled.tolist() == [False] * 8 + [True] * 2
    assert found.rejected.epsilon == rough.nodes.epsilon


def test_check_by_separation_accepts_the_loop_of_a_torus() -> None:
    ring = measured(shapes.torus(2000, 0))
    turn = np.arange(12) * np.pi / 6
    places = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(12)]) * shapes.RING
    plan = plan_to(ring.cloud, ring.cloud.unit.to_unit(places))
    edges = np.array([[i, i + 1] for i in range(11)] + [[0, 11]])
    rough = RoughSkeleton(plan, edges, np.ones(12, bool))
    found = Check(rule="separation")(ring.cloud, rough, ring.surface, ring.thickness)
    assert (found.rejected, found.wider) == (None, None)
    assert found.accepted is rough


def test_check_by_separation_needs_surface_and_thickness(rod: Rod) -> None:
    rough = around(rod)
    for surface, thickness in ((None, rod.thickness), (rod.surface, None)):
        with pytest.raises(InputError, match="needs the ports surface and thickness"):
            Check(rule="separation")(rod.cloud, rough, surface, thickness)


# --- smooth


def chain(rod: Rod, count: int = 6) -> RoughSkeleton:
    plan = Merge()(plan_to(rod.cloud, axis_places(rod.cloud, count))).plan
    plan = replace(plan, nodes=replace(plan.nodes, ids=np.arange(count) * 10))
    return Link()(rod.cloud, plan).rough


def test_smooth_inserts_points_into_long_edges_and_names_them(rod: Rod) -> None:
    places = axis_places(rod.cloud, 11)[[0, 1, 3, 5, 7, 10]]
    plan = plan_to(rod.cloud, places, ids=np.arange(6) * 10)
    edges = np.array([[i, i + 1] for i in range(5)])
    rough = RoughSkeleton(plan, edges, np.ones(6, bool))
    plain = Smooth(insert=False)(rod.cloud, rough).skeleton
    fine = Smooth()(rod.cloud, rough).skeleton
    assert plain.node_ids.tolist() == [0, 10, 20, 30, 40, 50]
    np.testing.assert_array_equal(plain.edges, rough.edges)
    assert fine.node_ids[:6].tolist() == plain.node_ids.tolist()
    assert fine.node_ids[6:].tolist() == list(range(51, 51 + len(fine) - 6))
    assert len(fine) > 6
    for found in (plain, fine):
        assert found.summary()["leaves"] == 2
        assert found.header == HEADER
        assert found.assignment is None
        assert found.diagnostics["rough_nodes"] == 6


@pytest.mark.parametrize("power", [1, 2])
def test_smooth_is_in_input_units(rod: Rod, power: int) -> None:
    scaled = measured(rod.points.positions * 50 + 7)
    stage = Smooth(power=power)
    near, far = (stage(r.cloud, chain(r)).skeleton for r in (rod, scaled))
    np.testing.assert_allclose(far.nodes, near.nodes * 50 + 7, atol=1e-6)
    np.testing.assert_allclose(far.radius, near.radius * 50, rtol=1e-9)
    assert np.abs(near.nodes[:, 1:]).max() < 0.03


def test_smoothing_straightens_a_bent_chain(rod: Rod) -> None:
    places = axis_places(rod.cloud, 8)
    places[::2, 1] += 0.03
    plan = plan_to(rod.cloud, places)
    edges = np.array([[i, i + 1] for i in range(7)])
    rough = RoughSkeleton(plan, edges, np.ones(8, bool))

    def bend(smoothing: float) -> float:
        stage = Smooth(smoothing=smoothing, insert=False, theta=1.0, max_steps=9)
        nodes = stage(rod.cloud, rough).skeleton.nodes
        return float(np.linalg.norm(np.diff(nodes, n=2, axis=0)))

    assert bend(0.9) < 0.8 * bend(0.0)


def test_smoothing_by_scatter_straightens_what_is_flat_and_lets_a_ring_bend() -> None:
    """A slab is known to its width only, and its chain zigzags; a thin ring is known well."""
    rng = np.random.default_rng(0)
    slab = measured(rng.uniform([-2.0, -0.5, -0.03], [2.0, 0.5, 0.03], (4000, 3)))
    zigzag = np.stack(
        [np.linspace(-1.8, 1.8, 10), 0.3 * (-1.0) ** np.arange(10), np.zeros(10)], axis=1
    )
    edges = np.array([[i, i + 1] for i in range(9)])

    def off(stage: Smooth, spread: Rod, places: np.ndarray, edges: np.ndarray) -> np.ndarray:
        plan = plan_to(spread.cloud, spread.cloud.unit.to_unit(places))
        rough = RoughSkeleton(plan, edges, np.ones(len(places), bool))
        return stage(spread.cloud, rough).skeleton.nodes

    shared = {"bends": "scatter", "theta": 0.5, "stretch": False, "spacing": 0.1}
    scatter, none = Smooth(smoothing=0.9, **shared), Smooth(smoothing=0.0, **shared)
    bends = [np.abs(off(stage, slab, zigzag, edges)[:, 1]).mean() for stage in (scatter, none)]
    assert bends[0] < 0.5 * bends[1]

    points = shapes.torus(3000)
    reach = np.linalg.norm(points[:, :2], axis=1)
    middle, turn = 0.5 * (reach.max() + reach.min()), np.arange(12) * np.pi / 6
    places = middle * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    loop = np.array([[i, i + 1] for i in range(11)] + [[0, 11]])
    found = off(scatter, measured(points), places, loop)
    assert np.abs(np.linalg.norm(found[:, :2], axis=1) / middle - 1.0).max() < 0.03


def test_smooth_keeps_a_lone_node_of_a_ball_and_makes_a_segment_of_a_rod(rod: Rod) -> None:
    none, skeletal = np.empty((0, 2), np.int64), np.ones(1, bool)
    ball = Density()(PointCloud(shapes.ball(900))).cloud
    found = Smooth()(ball, RoughSkeleton(plan_to(ball, np.zeros((1, 3))), none, skeletal)).skeleton
    assert (len(found.nodes), len(found.edges)) == (1, 0)
    assert found.mass.tolist() == [1.0]
    assert np.linalg.norm(found.nodes[0]) < 0.05
    plan = plan_to(rod.cloud, np.zeros((1, 3)))
    found = Smooth()(rod.cloud, RoughSkeleton(plan, none, skeletal)).skeleton
    assert (found.summary()["components"], found.summary()["leaves"]) == (1, 2)
    assert found.mass.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("over_thickness", [True, False])
def test_smooth_assigns_the_points_that_it_is_given(rod: Rod, over_thickness: bool) -> None:
    rough = chain(rod)
    thickness = rod.thickness if over_thickness else None
    rough = replace(
        rough, plan=replace(rough.plan, epsilon=1.0 if over_thickness else rough.plan.epsilon)
    )
    if over_thickness:
        nodes = replace(rough.nodes, scale=np.full(6, np.median(rod.thickness.radius)))
        rough = replace(rough, plan=replace(rough.plan, nodes=nodes))
    stage = Smooth(assign=True)
    own = stage(rod.cloud, rough, thickness).skeleton
    assert own.assignment is not None
    assert own.assignment.shape == (len(rod.cloud),)
    other = PointCloud(shapes.cylinder(300, 8))
    found = stage(rod.cloud, rough, thickness, other).skeleton
    assert found.assignment is not None
    assert found.assignment.shape == (300,)
    # Along a straight rod, a point's node is one of those next to it.
    away = np.abs(found.nodes[found.assignment, 0] - other.positions[:, 0])
    assert np.median(away) < 0.2
    again = stage(rod.cloud, rough, thickness, rod.points).skeleton.assignment
    np.testing.assert_array_equal(again, own.assignment)


# --- read and write


def test_read_drops_or_refuses_what_is_not_finite(tmp_path: Path) -> None:
    points = np.vstack([shapes.ball(20), [[np.nan, 0, 0]]])
    np.save(tmp_path / "cloud.npy", points)
    found = Read(path=tmp_path / "cloud.npy", frame_id="map")().cloud
    np.testing.assert_array_equal(found.positions, points[:-1])
    assert (found.dropped, found.header) == (1, Header("map"))
    with pytest.raises(InputError, match="1 of 21 points") as caught:
        Read(path=tmp_path / "cloud.npy", nonfinite="refuse")()
    assert caught.value.where == str(tmp_path / "cloud.npy")


def test_read_refuses_a_cloud_without_a_finite_point(tmp_path: Path) -> None:
    np.save(tmp_path / "cloud.npy", np.full((4, 3), np.nan))
    with pytest.raises(InputError, match="all points hold NaN or infinity") as caught:
        Read(path=tmp_path / "cloud.npy")()
    assert caught.value.where == str(tmp_path / "cloud.npy")


def test_read_names_the_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.ply"):
        Read(path=tmp_path / "nothing.ply")()


def test_write_gives_the_file_and_nothing_else(rod: Rod, tmp_path: Path) -> None:
    skeleton = Smooth()(rod.cloud, chain(rod)).skeleton
    assert Write(path=tmp_path / "s.json")(skeleton, rod.points) is None
    np.testing.assert_array_equal(Skeleton.load(tmp_path / "s.json").nodes, skeleton.nodes)
    assert [path.name for path in tmp_path.iterdir()] == ["s.json"]
    with pytest.raises(OutputError, match="no folder"):
        Write(path=tmp_path / "none" / "s.json")(skeleton)


def test_write_knows_its_suffixes_before_a_run() -> None:
    with pytest.raises(ValueError, match="suffix must be one of"):
        Write(path=Path("skeleton.obj"))


def test_matrices_of_a_plan_are_sparse(rod: Rod) -> None:
    plan = plan_to(rod.cloud, Seed()(rod.cloud).nodes.positions)
    assert isinstance(plan.plan, sparse.csr_array)
    assert plan.plan.nnz < 0.8 * np.prod(plan.plan.shape)
