"""The benchmark's own answers: truths that are true, damage that is what it says, fair scores."""

from __future__ import annotations

import json
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.stats import chisquare

from benchmarks.topology import (
    ablation,
    audit,
    methods,
    models,
    paper,
    pool,
    run,
    sensitivity,
    table,
)
from benchmarks.topology.builder import unit
from benchmarks.topology.cases import Case, all_cases, select
from benchmarks.topology.damage import DAMAGES, LEAST_LEFT, least_left
from benchmarks.topology.peers import Result, prune_spurs
from benchmarks.topology.score import densify, failed, score
from benchmarks.topology.shapes import HELD_OUT, RANDOM, RANDOM_HELD_OUT, SHAPES, make
from benchmarks.topology.shapes_random import random_shape
from benchmarks.topology.solid import (
    Shape,
    cone_distance,
    cones,
    graph_counts,
    hidden,
    sample,
    signed_distance,
)
from benchmarks.topology.views import seen_by
from mdcs_pipeline.config import load_spec
from mdcs_pipeline.errors import ConfigError

EVERY = [*SHAPES, *HELD_OUT]
DRAWN = [RANDOM[0], RANDOM[4], RANDOM_HELD_OUT[0]]


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def solid(nodes, edges, radius, counts=(1, 0, 2)) -> Shape:
    nodes, radius = np.asarray(nodes, float), np.asarray(radius, float)
    edges = np.asarray(edges)
    reach = radius[:, None]
    span = (nodes + reach).max(0) - (nodes - reach).min(0)
    return Shape("test", nodes, edges, radius, *counts, float(np.linalg.norm(span)))


CAPSULE = solid([(0, 0, 0), (2, 0, 0)], [(0, 1)], [0.5, 0.5])
CONE = solid([(0, 0, 0), (2, 0, 0)], [(0, 1)], [0.8, 0.3])


def test_there_are_enough_shapes_and_none_is_both_tuned_and_held_out():
    assert len(SHAPES) >= 20
    assert len(HELD_OUT) >= 6
    assert not set(SHAPES) & set(HELD_OUT)


@pytest.mark.parametrize("name", [*EVERY, *DRAWN])
def test_expected_counts_are_those_of_the_graph(name):
    shape = make(name)
    found = graph_counts(len(shape.nodes), shape.edges)
    assert found == (shape.components, shape.cycles, shape.leaves)


@pytest.mark.parametrize("name", [*EVERY, *DRAWN])
def test_expected_counts_are_those_of_the_solid(name):
    """Limbs that fuse by accident would make the graph's counts a lie about the cloud."""
    shape = make(name)
    assert audit.solid_counts(shape, 220) == (shape.components, shape.cycles, 0)


def test_the_solid_audit_sees_a_loop_closed_by_accident():
    places = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0.1, 0)]
    edges = [(0, 1), (1, 2), (2, 3), (3, 4)]
    closed = solid(places, edges, [0.08] * 5)
    assert audit.solid_counts(closed, 80)[:2] == (1, 1)
    assert audit.clearance(closed) < 0


@pytest.mark.parametrize("name", [*EVERY, *DRAWN])
def test_every_leaf_sticks_out_of_the_rest(name):
    """A stub inside another limb would be a leaf that no cloud shows."""
    assert audit.spur_reach(make(name)) > 1.5


@pytest.mark.parametrize("name", DRAWN)
def test_a_drawn_shape_is_the_same_each_time_and_has_no_sharp_corner(name):
    shape = make(name)
    random_shape.cache_clear()
    again = make(name)
    np.testing.assert_array_equal(again.nodes, shape.nodes)
    np.testing.assert_array_equal(again.edges, shape.edges)
    ways = {node: [] for node in range(len(shape.nodes))}
    for i, j in shape.edges.tolist():
        way = unit(shape.nodes[j] - shape.nodes[i])
        ways[i].append(way)
        ways[j].append(-way)
    assert max(a @ b for near in ways.values() for a, b in combinations(near, 2)) < 0.5


def test_drawn_shapes_that_may_be_looked_at_and_that_may_not_differ():
    assert len(RANDOM) == len(RANDOM_HELD_OUT) == 24
    assert not set(RANDOM) & set(RANDOM_HELD_OUT)


@pytest.mark.parametrize("name", ["hand5", "hand4"])
def test_fingers_have_a_gap_of_half_their_radius(name):
    shape = make(name)
    frames = [c for c in cones(shape) if c.axis[2] > 0.999 and c.start[2] >= 0.5]
    assert len(frames) == 4
    for first in frames:
        for second in frames:
            if first is not second:
                steps = np.linspace(0, first.length, 20)[:, None]
                axis = first.start + steps * first.axis
                own = first.radii[0] - steps[:, 0] * first.sine
                assert (cone_distance(second, axis) - own).min() > 0.49 * first.radii[0]


def test_distance_to_a_capsule_and_a_cone():
    points = np.array([(1, 2, 0), (-1, 0, 0), (1, 0, 0), (3, 0, 0)], dtype=float)
    np.testing.assert_allclose(signed_distance(CAPSULE, points), [1.5, 0.5, -0.5, 0.5])
    # The hull's distance is the least over all balls of the edge.
    part = np.linspace(0, 1, 4001)
    queries = rng().normal(size=(50, 3)) * 1.5
    centers, radii = np.outer(part, [2, 0, 0]), 0.8 - 0.5 * part
    brute = (np.linalg.norm(queries[:, None] - centers, axis=2) - radii).min(axis=1)
    np.testing.assert_allclose(signed_distance(CONE, queries), brute, atol=1e-6)


@pytest.mark.parametrize("name", ["humanoid", "dumbbell", "trefoil", "octopus", "egg"])
def test_samples_lie_on_the_union(name):
    shape = make(name)
    cloud = sample(shape, 1500, rng())
    assert len(cloud) == 1500
    assert np.abs(signed_distance(shape, cloud.points)).max() < 1e-6 * shape.diagonal
    out = cloud.points + 1e-3 * shape.diagonal * cloud.normals
    assert (signed_distance(shape, out) > 0).mean() > 0.97


def test_samples_are_uniform_by_area():
    """Both caps and both halves of a cone's side must hold their shares of the area."""
    cloud = sample(CONE, 40000, rng(3))
    sine = 0.25
    cap_a, cap_b = 2 * np.pi * 0.8**2 * (1 + sine), 2 * np.pi * 0.3**2 * (1 - sine)
    side = np.pi * 2 * (1 - sine**2) * 1.1
    part = (cloud.points @ [1, 0, 0] - cloud.radius * sine) / 2
    on_side = np.isclose(cloud.normals[:, 0], sine)
    half = np.count_nonzero(on_side & (part < 0.5))
    rest = np.count_nonzero(on_side) - half
    near = np.count_nonzero(~on_side & (cloud.points[:, 0] < 1))
    observed = [near, half, rest, len(cloud) - near - half - rest]
    first = (0.8 + 0.55) / (0.8 + 0.55 + 0.55 + 0.3)
    area = np.array([cap_a, side * first, side * (1 - first), cap_b])
    assert chisquare(observed, area / area.sum() * len(cloud)).pvalue > 1e-3


def test_joints_are_not_sampled_twice():
    """A bend's outer wedge belongs to both limbs' balls; its density must be the limbs' own."""
    bent = solid([(-1, 0, 0), (0, 0, 0), (0, 1, 0)], [(0, 1), (1, 2)], [0.4] * 3)
    cloud = sample(bent, 30000, rng(1))
    wedge = np.isclose(np.linalg.norm(cloud.points, axis=1), 0.4)
    wedge &= (cloud.points[:, 0] > 0) & (cloud.points[:, 1] < 0)
    arm = (cloud.points[:, 0] > -0.9) & (cloud.points[:, 0] < -0.5)
    expected = (np.pi * 0.4**2) / (2 * np.pi * 0.4 * 0.4)
    assert np.count_nonzero(wedge) / np.count_nonzero(arm) == pytest.approx(expected, rel=0.1)


def test_same_seed_same_cloud_other_seed_other_cloud():
    case = Case("shapes", "y", "noise-0.3", 0)
    np.testing.assert_array_equal(case.cloud(), case.cloud())
    other = Case("shapes", "y", "noise-0.3", 1).cloud()
    assert not np.array_equal(case.cloud(), other)


def test_noise_has_the_stated_sigma_of_each_points_radius():
    shape = make("humanoid")
    clean, noisy = (DAMAGES[d].apply(shape, 6000, rng(5)) for d in ("clean", "noise-0.3"))
    ratio = (noisy.points - clean.points) / clean.radius[:, None]
    assert ratio.std() == pytest.approx(0.3, rel=0.03)
    thin = clean.radius < np.median(clean.radius)
    assert ratio[thin].std() == pytest.approx(0.3, rel=0.04)


def test_loss_and_outliers_have_the_stated_counts():
    shape = make("y")
    assert len(DAMAGES["loss-50"].apply(shape, 2000, rng())) == 1000
    assert len(DAMAGES["loss-80"].apply(shape, 2000, rng())) == 400
    cloud = DAMAGES["outliers-5"].apply(shape, 2000, rng())
    stray = cloud.edge < 0
    assert np.count_nonzero(stray) == 100
    low, high = cloud.points[~stray].min(0), cloud.points[~stray].max(0)
    margin = 0.05 * (high - low) + 1e-9
    assert np.all((cloud.points >= low - margin) & (cloud.points <= high + margin))
    assert np.abs(signed_distance(shape, cloud.points[stray])).max() > 0.1


@pytest.mark.parametrize("name", ["holes-1.5", "holes-2.5"])
def test_holes_are_empty_balls_that_leave_every_limb_a_trace(name):
    shape = make("humanoid")
    before = DAMAGES["clean"].apply(shape, 6000, rng(2))
    after = DAMAGES[name].apply(shape, 6000, rng(2))
    kept = cKDTree(after.points).query(before.points)[0] == 0
    level = float(name.split("-")[1])
    gone = before.take(~kept)
    away = cKDTree(after.points).query(gone.points)[0]
    # The ball's centre is as far from any point left as the hole is wide.
    assert (away / gone.radius).max() >= level
    assert len(gone) <= 3 * 0.15 * 6000
    assert least_left(shape, before, kept) >= LEAST_LEFT


@pytest.mark.parametrize("name", ["density-7-smooth", "density-7-halves"])
def test_density_falls_by_seven(name):
    bar = solid([(0, 0, 0), (20, 0, 0)], [(0, 1)], [0.5, 0.5])
    x = DAMAGES[name].apply(bar, 20000, rng(4)).points[:, 0]
    assert len(x) == 20000
    counts = np.sort([np.count_nonzero(x < 1), np.count_nonzero(x > 19)])
    assert counts[1] / counts[0] == pytest.approx(7, rel=0.2)


def test_a_limb_hides_what_is_behind_it():
    nodes = [(-1, 0, 0), (1, 0, 0), (-1, 0, 2), (1, 0, 2)]
    bars = solid(nodes, [(0, 1), (2, 3)], [0.3, 0.3, 0.3, 0.3], (2, 0, 4))
    cloud = sample(bars, 4000, rng())
    camera = np.array([0.0, 0.0, 30.0])
    seen = seen_by(bars, cloud, camera)
    upper = cloud.points[:, 2] > 1
    assert seen[upper & (cloud.normals[:, 2] > 0.3)].all()
    assert not seen[cloud.normals[:, 2] < 0].any()
    behind = ~upper & (cloud.normals[:, 2] > 0.3) & (np.abs(cloud.points[:, 0]) < 0.9)
    assert seen[behind].mean() < 0.1


def test_hidden_agrees_with_marching_along_the_ray():
    shape = make("humanoid")
    cloud = sample(shape, 150, rng(8))
    camera = np.array([3.0, -6.0, 4.0])
    rays = camera - cloud.points
    front = np.einsum("ij,ij->i", rays, cloud.normals) > 0.2
    cloud, rays = cloud.take(front), rays[front]
    steps = np.linspace(0.01, 0.5, 400)[:, None, None]
    places = cloud.points + steps * rays
    inside = signed_distance(shape, places.reshape(-1, 3)).reshape(400, -1).min(axis=0)
    clear = np.abs(inside) > 2e-3
    found = hidden(shape, cloud.points, camera)
    np.testing.assert_array_equal(found[clear], inside[clear] < 0)


def test_views_have_the_number_of_points_and_misaligned_ones_leave_the_surface():
    shape = make("y")
    seen = DAMAGES["views-2"].apply(shape, 1001, rng())
    moved = DAMAGES["misaligned-2"].apply(shape, 1001, rng())
    assert len(seen) == len(moved) == 1001
    assert np.abs(signed_distance(shape, seen.points)).max() < 1e-5
    off = np.linalg.norm(moved.points - seen.points, axis=1) / np.median(seen.radius)
    assert 0.1 < np.median(off) < 0.5


def test_the_truth_itself_scores_nothing():
    shape = make("humanoid")
    found = score(shape.nodes, shape.edges, shape.radius, shape)
    assert found.errors == 0
    assert found.mean_to_truth == pytest.approx(0, abs=1e-9)
    assert found.hausdorff_from_truth < 0.1
    assert found.radius_error == pytest.approx(0, abs=2)


def test_shift_shows_in_every_distance():
    shape = make("helix")
    shift = np.array([0, 0, 0.02 * shape.diagonal])
    found = score(shape.nodes + shift, shape.edges, 2 * shape.radius, shape)
    assert 0.5 < found.mean_to_truth <= 2.0
    assert found.hausdorff_to_truth == pytest.approx(2.0, abs=0.1)
    assert found.radius_error == pytest.approx(100, abs=1)


def test_a_lost_edge_an_added_edge_and_a_spur_are_one_error_each():
    shape = make("frame")
    lost = score(shape.nodes, shape.edges[:-1], None, shape)
    assert (lost.delta_components, lost.delta_cycles, lost.delta_leaves) == (0, -1, 2)
    assert lost.errors == 3
    assert lost.hausdorff_from_truth > 10 > lost.hausdorff_to_truth
    added = score(shape.nodes, np.vstack([shape.edges, (0, 2)]), None, shape)
    assert (added.errors, added.delta_cycles) == (1, 1)
    nodes = np.vstack([shape.nodes, shape.nodes[0] + 0.1])
    spur = score(nodes, np.vstack([shape.edges, (0, len(shape.nodes))]), None, shape)
    assert (spur.errors, spur.delta_leaves) == (1, 1)
    alone = score(nodes, shape.edges, None, shape)
    assert (alone.errors, alone.delta_components) == (1, 1)


def test_distances_weigh_length_not_nodes():
    """A crowd of nodes at one end must not drown a long edge that goes astray."""
    shape = solid([(0, 0, 0), (10, 0, 0)], [(0, 1)], [0.1, 0.1])
    crowd = np.linspace(0, 0.1, 50)
    nodes = np.vstack([np.outer(crowd, [1, 0, 0]), [(10, 5, 0)]])
    chain = np.stack([np.arange(50), np.arange(1, 51)], axis=1)
    found = score(nodes, chain, None, shape)
    assert found.mean_to_truth == pytest.approx(100 * 2.5 / shape.diagonal, rel=0.05)


def test_a_method_that_gives_nothing_misses_all():
    shape = make("theta")
    assert failed(shape).errors == shape.components + shape.cycles + shape.leaves


@pytest.mark.parametrize(
    ("nodes", "edges", "match"),
    [
        ([(0, 0, np.nan)], [], "finite"),
        ([(0, 0, 0)], [(0, 1)], "outside"),
        ([(0, 0, 0)], [(0, 0)], "itself"),
    ],
)
def test_a_broken_graph_is_refused(nodes, edges, match):
    with pytest.raises(ValueError, match=match):
        score(nodes, edges, None, make("y"))


def test_densify_keeps_lone_nodes_and_interpolates():
    nodes = np.array([(0, 0, 0), (1, 0, 0), (5, 5, 5)], dtype=float)
    points, values = densify(nodes, np.array([(0, 1)]), 0.1, np.array([0.0, 1.0, 7.0]))
    assert np.any(np.all(points == 5, axis=1))
    on_edge = values < 5
    np.testing.assert_allclose(values[on_edge], points[on_edge, 0])


def test_pruning_cuts_short_spurs_only():
    nodes = np.array([(0, 0, 0), (1, 0, 0), (2, 0, 0), (1, 0.1, 0), (5, 0, 0), (5.1, 0, 0)], float)
    edges = np.array([(0, 1), (1, 2), (1, 3), (4, 5)])
    kept, pairs = prune_spurs(nodes, edges, 0.2)
    assert graph_counts(len(kept), pairs) == (2, 0, 4)
    assert len(kept) == 5


def test_filters_choose_whole_names():
    chosen = select(2, "shapes", "y,hand.", "noise-.*")
    assert {c.shape for c in chosen} == {"y", "hand4", "hand5"}
    assert {c.damage for c in chosen} == {"noise-0.15", "noise-0.3", "noise-0.5"}
    assert {c.seed for c in chosen} == {0, 1}
    assert len(set(all_cases(3))) == len(all_cases(3))
    assert {c.seed for c in select(2, first=100)} == {100, 101}
    assert not {c.shape for c in select(1, "shapes")} & set(HELD_OUT)


def test_a_raising_method_is_a_failed_case_with_its_message(monkeypatch):
    def raises(points):
        raise RuntimeError("no skeleton today")

    monkeypatch.setitem(methods.PEERS, "raises", raises)
    line = pool.run_task((Case("shapes", "y", "clean", 0), "raises"))
    assert line["failed"]
    assert line["errors"] == 4
    assert "no skeleton today" in line["message"]


def test_results_and_tables_round_trip(monkeypatch, tmp_path):
    shape = make("y")
    answer = Result(shape.nodes, shape.edges, shape.radius)
    monkeypatch.setitem(methods.PEERS, "oracle", lambda points: answer)
    lines = [pool.run_task((Case("shapes", "y", "clean", s), "oracle")) for s in (0, 1)]
    path = tmp_path / "deep" / "out.json"
    run.save(path, lines)
    assert run.load(path) == json.loads(json.dumps(lines))
    assert len(run.merged(lines, lines)) == 2
    readme = tmp_path / "README.md"
    readme.write_text(f"before\n{table.BEGIN}\nold\n{table.END}\nafter\n")
    table.write_readme(lines, readme)
    text = readme.read_text()
    assert "100 % (2/2; 0)" in text
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "old" not in text


def test_settings_follow_a_configuration():
    cloud = Case("shapes", "y", "clean", 0).cloud()
    whole = methods.method("mdcs:default")(cloud)
    coarse = methods.method("mdcs:default+downsample.voxel=0.05+transport.marginals=balanced")(
        cloud
    )
    with pytest.raises(ConfigError, match="marginals"):
        methods.method("mdcs:default+transport.marginals=0")(cloud)
    assert len(coarse.nodes) != len(whole.nodes)


def test_an_unknown_method_is_named():
    with pytest.raises(ValueError, match="nonsense"):
        methods.method("nonsense")


@pytest.mark.skipif(not models.has_data(), reason="needs the shared data")
class TestTable4:
    def test_there_are_27_cases(self):
        assert len(paper.TABLE4_MODELS) * len(paper.TABLE4_DAMAGES) == 27

    def test_damage_is_as_stated(self):
        clean = paper.clean_cloud("wolf")
        assert len(paper.damaged("wolf", "missing-40", rng())) == round(0.6 * len(clean))
        moved = paper.damaged("wolf", "noise-2.5", rng()) - clean
        assert moved.std() == pytest.approx(2.5 * paper.least_distance(clean), rel=0.05)
        assert 0 < len(clean) - len(paper.damaged("wolf", "ball-2.0", rng())) < len(clean) / 2

    def test_the_wolfs_skeleton_lies_in_the_wolf(self):
        """The mesh has another frame; a wrong map would put the truth beside the cloud."""
        clean, truth = paper.clean_cloud("wolf"), paper.truth("wolf")
        assert graph_counts(len(truth.nodes), truth.edges) == (1, 0, 7)
        away = cKDTree(clean).query(truth.nodes)[0] / truth.diagonal
        assert np.median(away) < 0.06
        inside = (truth.nodes > clean.min(0)) & (truth.nodes < clean.max(0))
        assert inside.all()


@pytest.mark.parametrize("stage", sorted(ablation.PASSED))
def test_a_stage_is_left_out_and_the_rest_still_fits(stage):
    spec = load_spec(ablation.without(stage))
    assert stage not in spec.stages
    assert set(load_spec("default").stages) - set(spec.stages) == {
        stage,
        *ablation.WITH.get(stage, ()),
    }


def test_what_cannot_be_left_out_is_named():
    with pytest.raises(ValueError, match="transport"):
        methods.method("mdcs:without-transport")


def test_a_number_moves_by_its_share_and_a_whole_one_stays_whole() -> None:
    assert sensitivity.moved(0.5, 0.3) == pytest.approx(0.65)
    assert sensitivity.moved(-0.9, 0.3) == pytest.approx(-1.17)
    assert [sensitivity.moved(value, -0.3) for value in (1000, 8, 1)] == [700, 6, 0]
    assert sensitivity.moved(1, 0.3) == 2


def test_every_number_of_the_default_configuration_is_varied() -> None:
    numbers = sensitivity.numbers()
    assert numbers["transport.epsilon"] == 1.5
    assert numbers["bridge.girth_aim"] == 0.5
    assert not {"seed.seed", "transport.power"} & set(numbers)
    assert not sensitivity.allowed({"merge.cosine": sensitivity.moved(-0.9, 0.3)})
    assert sensitivity.allowed({"transport.epsilon": sensitivity.moved(1.5, 0.3)})


def test_settings_stand_in_the_order_of_what_they_cost() -> None:
    rows = [
        sensitivity.Row("a.still", 1.0, 8, None),
        sensitivity.Row("b.little", 2.0, 8, 7),
        sensitivity.Row("c.much", 3.0, 4, 9),
    ]
    lines = sensitivity.table(10, 8, rows).splitlines()
    assert lines[4:6] == ["| `c.much` | 3 | -40.0 | +10.0 |", "| `b.little` | 2 | +0.0 | -10.0 |"]
    assert lines[-1] == "The count stays the same with `a.still`."


def test_a_setting_is_judged_case_by_case() -> None:
    case = Case("shapes", "y", "clean", 0)
    assert sensitivity.right([{}, {"downsample.voxel": 0.3}], case) == [True, False]


def test_some_settings_alone_are_no_table_for_the_readme(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        sensitivity.main(["--only", "untie", "--readme"])
    assert "--only" in capsys.readouterr().err
    _, rows = sensitivity.measure([Case("shapes", "y", "clean", 0)], 1, "^untie.loop")
    assert [(row.setting, row.less, row.more) for row in rows] == [("untie.loop", 1, 1)]
