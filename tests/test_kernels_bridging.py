"""Ends, rims, bridges and spurs on shapes with known answers."""

from __future__ import annotations

import numpy as np
import pytest
from problems import line
from scipy.spatial.distance import cdist

from mdcs_pipeline.kernels.bridging import BridgeRule, bridges
from mdcs_pipeline.kernels.courses import Course
from mdcs_pipeline.kernels.ends import End, limb_ends, lone_segments, stretched
from mdcs_pipeline.kernels.nearest import nearest
from mdcs_pipeline.kernels.rims import free_angle
from mdcs_pipeline.kernels.shore import Shore
from mdcs_pipeline.kernels.spurs import shed_spurs, shed_strays

NONE = np.empty((0, 2), np.int64)
NOWHERE = np.empty((0, 3))


def nearest_node(points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    return cdist(points, nodes).argmin(axis=1)


def cut_line(low: float, high: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A capsule without its part from `low` to `high`: points, nodes, and the edges left."""
    shape = line(3000)
    x = shape.points[:, 0]
    points = shape.points[(x < low) | (x > high)]
    kept = (shape.nodes[:, 0] < low) | (shape.nodes[:, 0] > high)
    edges = shape.edges[kept[shape.edges].all(axis=1)]
    return points, shape.nodes[kept], (np.cumsum(kept) - 1)[edges]


def rims(points: np.ndarray) -> np.ndarray:
    return free_angle(points, nearest(points, 12).indices) > 2.2


def ends_of(points: np.ndarray, nodes: np.ndarray, edges: np.ndarray) -> list[End]:
    scale, owner = np.full(len(nodes), 0.1), nearest_node(points, nodes)
    return limb_ends(nodes, scale, edges, points, owner, rims(points))


def shore_of(points: np.ndarray, nodes: np.ndarray) -> Shore:
    return Shore.around(nodes, np.full(len(nodes), 0.1), points, nearest_node(points, nodes))


# -------------------------------------------------------------------------------------- rims


def test_the_edge_of_a_sheet_is_a_rim_and_its_inside_is_not():
    x, y = np.meshgrid(np.arange(12.0), np.arange(12.0))
    jitter = np.random.default_rng(0).normal(scale=0.05, size=(144, 3))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(144)]) + jitter
    edge = (x.ravel() % 11 == 0) | (y.ravel() % 11 == 0)
    found = free_angle(points, nearest(points, 8).indices)
    assert found[edge].min() > 0.8 * np.pi
    assert found[~edge].max() < 0.6 * np.pi


def test_free_angles_turn_with_the_cloud():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(80, 3)) * [1, 1, 0.1]
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    indices = nearest(points, 10).indices
    np.testing.assert_allclose(
        free_angle(points @ turn + 3.0, indices), free_angle(points, indices), atol=1e-9
    )


# -------------------------------------------------------------------------------------- ends


def test_a_capped_end_is_closed_and_a_cut_one_is_open():
    ends = ends_of(*cut_line(0.41, 0.64))
    place = {round(float(end.place[0]), 2): end for end in ends}
    assert sorted(place) == [0.0, 0.4, 0.65, 1.0]
    for x, outward in ((0.0, -1.0), (0.4, 1.0), (0.65, -1.0), (1.0, 1.0)):
        np.testing.assert_allclose(place[x].outward, [outward, 0, 0], atol=1e-12)
    for x in (0.4, 0.65):
        assert place[x].radius == pytest.approx(0.1, rel=0.05)
        assert place[x].openness > BridgeRule().openness
        # The node stands in the middle of its rim, which then points nowhere.
        assert not place[x].rimward.any()
    for x in (0.0, 1.0):
        assert place[x].openness < 0.1


def test_an_end_without_points_or_length_is_none():
    points, nodes, edges = cut_line(0.41, 0.64)
    flat = np.zeros((2, 3))
    owner = np.zeros(len(points), np.int64)
    assert limb_ends(flat, np.ones(2), np.array([[0, 1]]), points, owner) == []
    few = limb_ends(nodes, np.full(len(nodes), 0.1), edges, points[:3], owner[:3])
    assert few == []


def test_a_node_on_its_own_is_an_end_without_direction_where_rims_are_known():
    points, nodes, _ = cut_line(0.41, 0.64)
    slab = points[points[:, 0] > 0.64]
    found = ends_of(slab, nodes[-1:], NONE)
    assert [end.node for end in found] == [0]
    assert not found[0].outward.any()
    assert limb_ends(nodes[-1:], np.ones(1), NONE, slab, np.zeros(len(slab), np.int64)) == []


def test_ends_are_stretched_to_one_radius_before_the_tip():
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    ends = [
        end(0, nodes[0], [-1, 0, 0])._replace(extent=0.4),
        end(2, nodes[2], [1, 0, 0])._replace(extent=0.05),
    ]
    wanted = [[-0.3, 0, 0], [1, 0, 0], [2, 0, 0]]
    np.testing.assert_allclose(stretched(nodes, ends), wanted, atol=1e-12)


def test_a_lone_node_of_a_capsule_is_its_medial_segment_and_that_of_a_ball_none():
    shape = line(4000)
    owner = np.zeros(len(shape.points), np.int64)
    (found,) = lone_segments(np.array([[0.5, 0, 0]]), NONE, shape.points, owner, shape.points)
    tips = found.tips[np.argsort(found.tips[:, 0])]
    np.testing.assert_allclose(tips, [[0, 0, 0], [1, 0, 0]], atol=0.06)
    ball = np.random.default_rng(0).normal(size=(500, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    assert lone_segments(np.zeros((1, 3)), NONE, ball, np.zeros(500, np.int64), ball) == []
    # Nodes with edges are left alone.
    two = np.array([[0.2, 0, 0], [0.8, 0, 0]])
    assert lone_segments(two, np.array([[0, 1]]), shape.points, owner, shape.points) == []


def test_a_lone_node_whose_tips_are_gone_reaches_as_far_as_its_medial_places():
    whole = line(4000)
    along = whole.points[:, 0]
    # The middle of the barrel alone is wider than it is long.
    points = whole.points[(along > 0.42) & (along < 0.58)]
    owner, middle = np.zeros(len(points), np.int64), np.array([[0.5, 0, 0]])
    assert lone_segments(middle, NONE, points, owner, points) == []
    places = points * [1, 0, 0]
    (found,) = lone_segments(middle, NONE, points, owner, places)
    tips = found.tips[np.argsort(found.tips[:, 0])]
    np.testing.assert_allclose(tips, [[0.42, 0, 0], [0.58, 0, 0]], atol=0.01)
    # A ball's lie in its centre.
    at_centre = points * 0.0 + middle
    assert lone_segments(middle, NONE, points, owner, at_centre) == []


# ----------------------------------------------------------------------------------- bridges


def test_the_two_sides_of_a_hole_are_bridged():
    points, nodes, edges = cut_line(0.41, 0.64)
    ends, shore = ends_of(points, nodes, edges), shore_of(points, nodes)
    built = bridges(edges, ends, shore, BridgeRule())
    assert nodes[built[0], 0].tolist() == pytest.approx([0.4, 0.65])
    assert len(built) == 1
    # Too far, in radii.
    assert bridges(edges, ends, shore, BridgeRule(reach=1.2)).shape == (0, 2)


def test_a_bridge_does_not_lead_through_the_surface():
    points, nodes, edges = cut_line(0.41, 0.64)
    ends = ends_of(points, nodes, edges)
    rng = np.random.default_rng(0)
    wall = np.column_stack([np.full(900, 0.52), rng.uniform(-0.3, 0.3, (900, 2))])
    owner = np.append(nearest_node(points, nodes), np.zeros(900, np.int64))
    walled = np.concatenate([points, wall])
    shore = Shore.around(nodes, np.full(len(nodes), 0.1), walled, owner)
    assert bridges(edges, ends, shore, BridgeRule()).shape == (0, 2)


@pytest.mark.parametrize("radius", [0.02, 0.1, 0.4])
def test_what_lies_around_a_way_is_counted_as_among_all_points(radius):
    rng = np.random.default_rng(3)
    points = rng.uniform(-1.0, 1.0, (4000, 3))
    nodes = np.zeros((1, 3))
    shore = Shore.around(nodes, np.ones(1), points, np.zeros(4000, np.int64))
    for goal in rng.uniform(-1.0, 1.0, (20, 3)):
        one = end(0, rng.uniform(-1.0, 1.0, 3), [1, 0, 0], radius)
        offset, way = points - one.place, goal - one.place
        along = offset @ way / (way @ way)
        across = np.linalg.norm(offset - np.outer(along, way), axis=1)
        count = np.count_nonzero((along > 0) & (along < 1) & (across < 0.5 * radius))
        assert shore.pierced(one, goal, (count - 0.5) / 4000)
        assert not shore.pierced(one, goal, (count + 0.5) / 4000)


def end(node: int, place, outward, radius: float = 0.1, openness: float = 1.0) -> End:
    outward = np.array(outward, float) / np.linalg.norm(outward)
    course = Course(outward, np.zeros(3))
    place = np.array(place, float)
    return End(node, place, outward, radius, openness, radius, np.zeros(3), course)


def bridged(
    ends: list[End], extra=(), rule: BridgeRule | None = None, pairs: np.ndarray = NONE
) -> list[list[int]]:
    """Bridges between ends in empty space, each a piece of its own without `pairs`."""
    nodes = np.array([e.place for e in ends] + [list(map(float, p)) for p in extra])
    shore = Shore.around(nodes, np.full(len(nodes), 1e-6), NOWHERE, np.empty(0, np.int64))
    return bridges(pairs, ends, shore, rule or BridgeRule(aim=0.99)).tolist()


def test_only_open_ends_of_like_radius_that_face_each_other_are_joined():
    right, left = [1, 0, 0], [-1, 0, 0]
    near = [0.5, 0, 0]
    # The aim at other pieces is off: what is left is the meeting of two ends.
    never = BridgeRule(aim=2.0)
    assert bridged([end(0, [0, 0, 0], right), end(1, near, left)], rule=never) == [[0, 1]]
    for other in (
        end(1, near, right),
        end(1, near, left, radius=0.4),
        end(1, [2, 0, 0], left),
        end(1, [0, 0, 0], left),
    ):
        assert bridged([end(0, [0, 0, 0], right), other], rule=never) == []


def test_of_two_facing_ends_one_may_be_closed_if_the_other_is_wide_open():
    never = BridgeRule(aim=2.0, openness=0.3)
    for here, there, wanted in (
        (0.6, 0.0, [[0, 1]]),
        (0.5, 0.0, []),
        (0.2, 0.5, [[0, 1]]),
        (5.0, -0.5, []),
    ):
        ends = [
            end(0, [0, 0, 0], [1, 0, 0], openness=here),
            end(1, [0.5, 0, 0], [-1, 0, 0], openness=there),
        ]
        assert bridged(ends, rule=never) == wanted


def test_a_flat_end_is_no_rim_though_it_looks_open():
    ends = [end(0, [0, 0, 0], [1, 0, 0]), end(1, [0.5, 0, 0], [-1, 0, 0])]
    nodes = np.array([e.place for e in ends])
    for scale, wanted in ((0.1, [[0, 1]]), (0.15, [[0, 1]]), (0.25, [])):
        shore = Shore.around(nodes, np.array([0.1, scale]), NOWHERE, np.empty(0, np.int64))
        assert bridges(NONE, ends, shore, BridgeRule(aim=2.0)).tolist() == wanted


def test_flat_ends_close_no_loop_by_aiming_but_join_pieces():
    ends = [end(0, [0, 0, 0], [1, 0, 0]), end(1, [0.5, 0, 0], [-1, 0, 0])]
    nodes = np.array([[0.0, 0, 0], [0.5, 0, 0], [0.25, 2, 0]])
    one_piece = np.array([[0, 2], [1, 2]])
    # No two rims that face each other: one has to aim at the other.
    rule = BridgeRule(girth=0.9)
    for pairs, scale, wanted in (
        (one_piece, 0.15, [[0, 1]]),
        (one_piece, 0.25, []),
        (NONE, 0.25, [[0, 1]]),
    ):
        shore = Shore.around(nodes, np.array([scale, 0.1, 0.1]), NOWHERE, np.empty(0, np.int64))
        assert bridges(pairs, ends, shore, rule).tolist() == wanted
        shore = shore._replace(scale=np.array([0.1, scale, 0.1]))
        assert bridges(pairs, ends, shore, rule).tolist() == wanted


def test_a_wall_that_only_the_wider_of_two_ends_meets_parts_them():
    ends = [end(0, [0, 0, 0], [1, 0, 0]), end(1, [0.5, 0, 0], [-1, 0, 0], radius=0.2)]
    nodes, pairs = np.array([[0.0, 0, 0], [0.5, 0, 0], [0.25, 2, 0]]), np.array([[0, 2], [1, 2]])
    turn = np.linspace(0, 2 * np.pi, 20)
    # A hole in a wall, wide enough for the thin end.
    wall = np.stack([np.full(20, 0.25), 0.08 * np.cos(turn), 0.08 * np.sin(turn)], axis=1)
    scale, rule = np.array([0.15, 0.3, 0.1]), BridgeRule(girth=0.9)
    for points, wanted in ((wall, []), (wall + np.array([0, 0.5, 0]), [[0, 1]])):
        shore = Shore.around(nodes, scale, points, np.zeros(20, np.int64))
        assert bridges(pairs, ends, shore, rule).tolist() == wanted


def test_a_ring_is_closed_along_its_circle_though_its_ends_look_away():
    # A gap of 200 degrees: the tangents of its ends stand 100 degrees off their chord.
    turn = np.deg2rad(80.0)
    tangent = np.array([-np.sin(turn), np.cos(turn), 0])
    one = end(0, [np.cos(turn), np.sin(turn), 0], tangent, radius=0.2)
    other = end(1, one.place * [1, -1, 1], tangent * [1, -1, 1], radius=0.2)
    never = BridgeRule(aim=2.0)
    assert bridged([one, other], rule=never) == []
    ends = [e._replace(course=Course(e.outward, -e.place)) for e in (one, other)]
    assert bridged(ends, rule=never) == [[0, 1]]


def test_a_wall_across_the_chord_does_not_hide_the_bent_way():
    ends = [end(0, [0, 0, 0], [0, 1, 0]), end(1, [0.6, 0, 0], [0, 1, 0])]
    nodes = np.array([e.place for e in ends])
    rng = np.random.default_rng(0)
    wall = np.column_stack([np.full(300, 0.3), rng.uniform(-0.15, 0.15, (300, 2))])
    higher = wall + np.array([0, 0.25, 0])
    # Ends of one half circle: looking aside is no fault.
    rule = BridgeRule(aim=2.0, facing=-0.1)
    for points, wanted in ((wall, [[0, 1]]), (np.concatenate([wall, higher]), [])):
        owner = np.zeros(len(points), np.int64)
        shore = Shore.around(nodes, np.full(2, 0.1), points, owner)
        assert bridges(NONE, ends, shore, rule).tolist() == wanted


def test_the_best_bridge_goes_first_and_each_end_has_one():
    ends = [
        end(0, [0, 0, 0], [1, 0, 0]),
        end(1, [0.4, 0, 0], [-1, 0, 0]),
        end(2, [0.6, 0.1, 0], [-1, 0, 0]),
    ]
    assert bridged(ends, rule=BridgeRule(aim=2.0)) == [[0, 1]]


def test_a_junction_of_three_in_a_hole_is_closed():
    away = [[np.cos(a), np.sin(a), 0.0] for a in (0.0, 2 * np.pi / 3, 4 * np.pi / 3)]
    ends = [end(k, 0.2 * np.array(d), -np.array(d)) for k, d in enumerate(away)]
    built = bridged(ends, rule=BridgeRule())
    assert len(built) == 2
    assert {i for pair in built for i in pair} == {0, 1, 2}


def test_bridges_that_cross_in_a_hole_are_tied():
    away = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    ends = [end(k, 0.2 * d, -d) for k, d in enumerate(away)]
    built = bridged(ends, rule=BridgeRule())
    assert [0, 1] in built
    assert [2, 3] in built
    assert len(built) == 3


def test_where_all_of_a_t_is_missing_the_stem_is_tied_to_the_bridge():
    ends = [
        end(0, [0, 0, 0], [1, 0, 0]),
        end(1, [0.6, 0, 0], [-1, 0, 0]),
        end(2, [0.25, 0.4, 0], [0, -1, 0]),
    ]
    assert bridged(ends, rule=BridgeRule()) == [[0, 1], [0, 2]]
    # One that looks away is not.
    away = end(2, ends[2].place, [0, 1, 0])
    assert bridged([*ends[:2], away], rule=BridgeRule()) == [[0, 1]]


def test_an_open_end_that_is_left_aims_at_another_piece():
    ends = [end(0, [0, 0, 0], [1, 0, 0])]
    extra = [[0.5, 0.02, 0], [0.3, 0.3, 0], [0.8, 0, 0], [-0.1, 0, 0]]
    assert bridged(ends, extra) == [[0, 1]]
    assert bridged(ends, [[5, 0, 0], [-0.2, 0, 0]]) == []


def test_an_end_aims_between_the_nodes_of_another_piece_but_closes_no_loop_there():
    ends = [end(0, [0, 0, 0], [1, 0, 0])]
    bar = [[0.5, 0.2, 0], [0.5, -0.45, 0]]
    assert bridged(ends, bar, BridgeRule(), np.array([[1, 2]])) == [[0, 1]]
    assert bridged(ends, bar, BridgeRule(aim_within=0.95), np.array([[0, 1], [1, 2]])) == []


def test_a_loop_is_closed_only_straight_ahead():
    ahead, aside = [0.5, 0, 0], [0.4, 0.45, 0]
    for goal, wanted in ((ahead, [[0, 1]]), (aside, [])):
        built = bridged(
            [end(0, [0, 0, 0], [1, 0, 0])], [goal], BridgeRule(), pairs=np.array([[0, 1]])
        )
        assert built == wanted


def test_a_ring_is_not_walled_by_its_own_tube_where_its_last_nodes_lag_behind_its_bend():
    # The tests before had straight limbs, or no points: a chord of the last nodes then leaves
    # the tube as its course does.
    turn = np.linspace(np.deg2rad(60.0), np.deg2rad(300.0), 4000)
    around = np.random.default_rng(5).uniform(0.0, 2 * np.pi, len(turn))
    radial = np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    tube = 0.35 * (np.cos(around)[:, None] * radial + np.sin(around)[:, None] * [0, 0, 1])
    points = radial + tube
    nodes = np.array([[np.cos(a), np.sin(a), 0] for a in np.deg2rad(np.arange(80, 300, 40.0))])
    edges = np.column_stack([np.arange(5), np.arange(1, 6)])
    owner = nearest_node(points, nodes)
    scale = np.full(len(nodes), 0.35)
    ends = limb_ends(nodes, scale, edges, points, owner, rims(points))
    lagging = [e._replace(openness=1.0) for e in ends]
    shore = Shore.around(nodes, scale, points, owner)
    assert bridges(edges, lagging, shore, BridgeRule(aim=2.0)).tolist() == [[0, 5]]
    straight = [e._replace(course=Course(e.outward, np.zeros(3))) for e in lagging]
    assert bridges(edges, straight, shore, BridgeRule(aim=2.0)).tolist() == []


def test_ends_that_met_at_an_angle_still_join_what_they_stood_on():
    # Two limbs of a star whose middle is gone face each other; the third has no open end.
    ends = [end(0, [0.2, 0, 0], [-1, 0, 0]), end(1, [0, 0.2, 0], [0, -1, 0])]
    hub = [[-0.2, -0.02, 0], [-0.4, -0.02, 0]]
    pairs = np.array([[2, 3]])
    assert bridged(ends, hub, BridgeRule(), pairs) == [[0, 1], [0, 2]]


def test_a_limb_that_goes_on_over_its_bridge_joins_nothing_else():
    # Beside the cut bar stands another: the bar's ends aim past each other's, at its side.
    ends = [end(0, [0, 0, 0], [1, 0, 0]), end(1, [0.3, 0, 0], [-1, 0, 0])]
    other = [[0.8, 0.1, 0], [0.9, 0.1, 0]]
    assert bridged(ends, other, BridgeRule(), np.array([[2, 3]])) == [[0, 1]]


def test_a_slice_of_a_pipe_joins_what_lies_on_its_other_side():
    lone = end(0, [0, 0, 0], [1, 0, 0])._replace(
        outward=np.zeros(3), course=Course(np.zeros(3), np.zeros(3))
    )
    ends = [lone, end(1, [0.4, 0, 0], [-1, 0, 0])]
    for x, wanted in ((-0.5, [[0, 1], [0, 2]]), (1.4, [[0, 1]])):
        goal = [[x, 0.0, 0], [x, 1.0, 0], [x, -1.0, 0]]
        pairs = np.array([[2, 3], [2, 4]])
        # Of its own the end aims at nothing: only what is left joins.
        built = bridged(ends, goal, BridgeRule(crowd_aim=-1.0), pairs)
        assert built == wanted


# ------------------------------------------------------------------------------------- spurs


def fork(length: float) -> tuple[np.ndarray, np.ndarray, list[End]]:
    """A limb along x of radius 1 with a short end at its middle node, and all of its ends."""
    nodes = np.array([[-3.0, 0, 0], [0, 0, 0], [3, 0, 0], [0, length, 0]])
    pairs = np.array([[0, 1], [1, 2], [1, 3]])
    ends = [
        end(0, nodes[0], [-1, 0, 0])._replace(extent=1.0),
        end(2, nodes[2], [1, 0, 0])._replace(extent=1.0),
        end(3, nodes[3], [0, 1, 0])._replace(extent=0.3),
    ]
    return nodes, pairs, ends


def test_an_end_within_the_thickness_of_its_junction_is_shed():
    for length, wanted in ((0.7, [0, 1, 2, 1]), (2.0, [0, 1, 2, 3])):
        nodes, pairs, ends = fork(length)
        assert shed_spurs(nodes, np.ones(4), pairs, ends, 1.2).tolist() == wanted


def test_the_last_branches_of_a_junction_are_never_shed():
    nodes, pairs, ends = fork(0.7)
    # All three ends are short of five radii: the shortest goes, and then there is no junction.
    assert shed_spurs(nodes, np.ones(4), pairs, ends, 5.0).tolist() == [0, 1, 2, 1]


# A limb of nodes 0 to 4, and two of a side limb on its node 2.
SIDE = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [2, 5], [5, 6]])


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize(
    ("counts", "radius", "stray"),
    [
        ([100, 100, 100, 100, 100, 10, 4], 1.0, True),
        ([100, 100, 100, 100, 100, 10, 40], 1.0, False),
        # Half as thick, it has as many points on its surface with a quarter of them.
        ([100, 100, 100, 100, 100, 10, 10], 0.5, False),
        # A scan that thins out along the limb does so on its side limb too.
        ([900, 300, 100, 33, 11, 40, 14], 1.0, False),
    ],
)
def test_a_limb_of_few_points_for_its_size_is_stray(
    counts: list[int], radius: float, stray: bool, unit: float
) -> None:
    scale = unit * np.array([1.0] * 5 + [radius] * 2)
    into = shed_strays(scale, np.array(counts), SIDE, 0.15)
    assert into.tolist() == ([0, 1, 2, 3, 4, 2, 2] if stray else list(range(7)))


def test_sparse_ends_without_a_junction_are_kept() -> None:
    chain, ring = SIDE[:4], np.array([[0, 1], [1, 2], [2, 3], [3, 4], [0, 4]])
    for pairs in (chain, ring):
        counts = np.array([1, 1, 100, 1, 1])
        assert shed_strays(np.ones(5), counts, pairs, 0.15).tolist() == [0, 1, 2, 3, 4]


def test_a_sparse_bow_between_junctions_is_no_limb() -> None:
    pairs = np.array([[0, 1], [1, 2], [2, 3], [1, 4], [2, 4]])
    counts = np.array([100, 100, 100, 100, 2])
    assert shed_strays(np.ones(5), counts, pairs, 0.15).tolist() == [0, 1, 2, 3, 4]
