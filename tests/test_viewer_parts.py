"""What the live page is made of, without a browser: tubes, colours, branches, film, addresses."""

from __future__ import annotations

import socket

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdcs_pipeline.config import load_spec
from mdcs_pipeline.demo import demo_cloud
from mdcs_pipeline.errors import ConfigError, InputError, MissingExtraError
from mdcs_pipeline.graph import build_graph
from mdcs_pipeline.ingest import as_point_cloud
from mdcs_pipeline.skeleton import Skeleton
from mdcs_pipeline.viewer.branches import branch_labels
from mdcs_pipeline.viewer.colours import JUNCTION, by_label, by_value, value_range
from mdcs_pipeline.viewer.drawing import SIZE, ball_radii, colours_of, point_size, space_of
from mdcs_pipeline.viewer.film import Dial, Film, Frame
from mdcs_pipeline.viewer.page import file_name
from mdcs_pipeline.viewer.remake import epsilon_dial, epsilons, remaker, with_epsilon
from mdcs_pipeline.viewer.server import free_port, import_viser, is_local, is_own_page, page_url
from mdcs_pipeline.viewer.texts import counts_text, legend_text, plain, times_text, title_text
from mdcs_pipeline.viewer.tubes import (
    Copies,
    Mesh,
    ball_copies,
    tube_copies,
    turns_from_z,
    unit_ball,
    unit_tube,
)


def skeleton(nodes: object, edges: object, **more: object) -> Skeleton:
    count = len(np.asarray(nodes))
    held = {
        "mass": np.full(count, 1 / count),
        "radius": np.ones(count),
        "node_ids": np.arange(count),
        **more,
    }
    return Skeleton(nodes=np.asarray(nodes, float), edges=np.asarray(edges), **held)


# A junction 0 with three arms: 0-1-2, 0-3, 0-4-5.
Y = skeleton(
    [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 2)],
    [(0, 1), (1, 2), (0, 3), (0, 4), (4, 5)],
    mass=np.array([6, 1, 2, 3, 4, 5]) / 21,
)


# --- tubes


def volume(mesh: Mesh) -> float:
    """Signed: positive if the faces are counter-clockwise from outside."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces].astype(float), 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def test_the_ball_is_closed_round_and_the_right_way_out() -> None:
    ball = unit_ball(24)
    np.testing.assert_allclose(np.linalg.norm(ball.vertices, axis=1), 1.0, rtol=1e-6)
    assert volume(ball) == pytest.approx(4 / 3 * np.pi, rel=0.03)
    sides = np.sort(ball.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert set(np.unique(sides, axis=0, return_counts=True)[1]) == {2}


def test_the_tube_is_round_open_and_the_right_way_out() -> None:
    tube = unit_tube(24)
    np.testing.assert_allclose(np.linalg.norm(tube.vertices[:, :2], axis=1), 1.0, rtol=1e-6)
    assert set(tube.vertices[:, 2]) == {0.0, 1.0}
    # The lids that it lacks: the bottom one holds nothing against the origin, the top a third.
    assert volume(tube) == pytest.approx(2 / 3 * np.pi, rel=0.02)


def turned(turn: np.ndarray, vector: np.ndarray) -> np.ndarray:
    w, axis = turn[0], turn[1:]
    return vector + 2 * np.cross(axis, np.cross(axis, vector) + w * vector)


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_turns_take_z_anywhere(way: tuple[float, float, float]) -> None:
    direction = np.array(way) / np.linalg.norm(way)
    (turn,) = turns_from_z(direction[None])
    assert np.linalg.norm(turn) == pytest.approx(1.0)
    np.testing.assert_allclose(turned(turn, np.array([0.0, 0.0, 1.0])), direction, atol=1e-6)


def test_straight_down_is_a_half_turn() -> None:
    (turn,) = turns_from_z(np.array([[0.0, 0.0, -1.0]]))
    np.testing.assert_allclose(turned(turn, np.array([0.0, 0.0, 1.0])), [0, 0, -1], atol=1e-12)


def placed(mesh: Mesh, copies: Copies, k: int) -> np.ndarray:
    scaled = mesh.vertices.astype(float) * copies.scales[k]
    return np.array([turned(copies.turns[k], v) for v in scaled]) + copies.positions[k]


def test_the_halves_of_an_edge_meet_in_its_middle_and_keep_their_radius() -> None:
    nodes = np.array([(1.0, 2.0, 3.0), (4.0, -2.0, 3.5)])
    colours = np.array([[(1, 2, 3), (4, 5, 6)]], np.uint8)
    copies = tube_copies(nodes, np.array([[0, 1]]), colours, radius=0.25)
    assert len(copies.positions) == 2
    axis = (nodes[1] - nodes[0]) / np.linalg.norm(nodes[1] - nodes[0])
    middle = nodes.mean(axis=0)
    for k in range(2):
        points = placed(unit_tube(), copies, k)
        along = (points - nodes[k]) @ (axis if k == 0 else -axis)
        half = np.linalg.norm(middle - nodes[k])
        np.testing.assert_allclose(sorted(set(np.round(along, 5))), [0, half], atol=1e-4)
        off = points - nodes[k] - np.outer((points - nodes[k]) @ axis, axis)
        np.testing.assert_allclose(np.linalg.norm(off, axis=1), 0.25, rtol=1e-4)
        np.testing.assert_array_equal(copies.colours[k], colours[0, k])


def test_edges_without_length_and_skeletons_without_edges_draw_nothing() -> None:
    nodes = np.array([(1.0, 2.0, 3.0)] * 2 + [(2.0, 2.0, 3.0)])
    colours = np.zeros((2, 2, 3), np.uint8)
    copies = tube_copies(nodes, np.array([[0, 1], [1, 2]]), colours, 0.1)
    assert len(copies.positions) == len(copies.colours) == 2
    assert all(np.isfinite(part).all() for part in copies)
    none = tube_copies(nodes, np.empty((0, 2), int), np.empty((0, 2, 3), np.uint8), 0.1)
    assert len(none.positions) == 0


def test_balls_stand_at_the_nodes_as_wide_as_the_tube_and_wider_with_mass() -> None:
    radii = ball_radii(Y, 0.5)
    assert (radii >= 0.5).all()
    assert np.argmax(radii) == np.argmax(Y.mass)
    assert np.argmin(radii) == np.argmin(Y.mass)
    copies = ball_copies(Y.nodes, np.zeros((6, 3), np.uint8), radii)
    np.testing.assert_allclose(placed(unit_ball(), copies, 2).mean(axis=0), [2, 0, 0], atol=1e-6)
    np.testing.assert_allclose(copies.scales[:, 1], radii, rtol=1e-6)


# --- colours and branches


def test_branches_run_between_ends_and_junctions() -> None:
    np.testing.assert_array_equal(branch_labels(Y.edges, 6), [0, 0, 1, 2, 2])


def test_a_ring_is_one_branch_and_a_ring_with_a_tail_two() -> None:
    ring = np.array([(0, 1), (1, 2), (2, 3), (0, 3)])
    assert set(branch_labels(ring, 4)) == {0}
    assert branch_labels(np.vstack([ring, (3, 4)]), 5).tolist() == [0, 0, 0, 0, 1]
    assert branch_labels(np.empty((0, 2), int), 3).tolist() == []


@given(st.permutations(range(5)))
def test_branches_do_not_depend_on_the_order_of_edges(order: list[int]) -> None:
    labels = np.empty(5, int)
    labels[list(order)] = branch_labels(Y.edges[list(order)], 6)
    groups = {frozenset(np.flatnonzero(labels == label)) for label in labels}
    assert groups == {frozenset({0, 1}), frozenset({2}), frozenset({3, 4})}


def test_colours_go_from_dark_to_light_and_bear_equal_values() -> None:
    colours = by_value(np.linspace(0, 1, 9)).astype(int).sum(axis=1)
    assert (np.diff(colours) >= 0).all()
    assert colours[-1] > 2 * colours[0]
    assert len(np.unique(by_value(np.full(4, 0.3)), axis=0)) == 1
    assert by_value(np.empty(0)).shape == (0, 3)


def test_one_giant_does_not_take_all_colours() -> None:
    values = np.append(np.linspace(1, 2, 99), 1e6)
    assert value_range(values)[1] < 3
    assert len(np.unique(by_value(values), axis=0)) > 50


def test_branches_that_follow_each_other_differ() -> None:
    colours = by_label(np.arange(30)).astype(int)
    assert len(np.unique(colours, axis=0)) == 30
    assert np.abs(np.diff(colours, axis=0)).sum(axis=1).min() > 60


def test_a_branch_has_one_colour_and_junctions_are_grey() -> None:
    nodes, edges = colours_of(Y, "branch")
    np.testing.assert_array_equal(nodes[0], JUNCTION)
    np.testing.assert_array_equal(nodes[2], edges[1, 0])
    np.testing.assert_array_equal(edges[0], edges[1])
    assert not np.array_equal(edges[0], edges[2])


def test_by_mass_both_halves_of_an_edge_have_the_colour_of_their_end() -> None:
    nodes, edges = colours_of(Y, "mass")
    np.testing.assert_array_equal(edges[1], nodes[[1, 2]])
    assert nodes[0].sum() > nodes[1].sum()
    # All radii are alike, so all of that colour too.
    assert len(np.unique(colours_of(Y, "radius")[0], axis=0)) == 1


# --- the page's space


@pytest.mark.parametrize(("scale", "shift"), [(1e-6, 0.0), (1.0, 4e6), (1e5, -3.0)])
def test_clouds_of_any_size_anywhere_fill_the_same_space(scale: float, shift: float) -> None:
    points = np.random.default_rng(0).normal(size=(500, 3)) * scale + shift
    space = space_of(Frame(points=points))
    assert space is not None
    seen = space.to_page(points).astype(np.float32)
    assert np.linalg.norm(np.ptp(seen, axis=0)) == pytest.approx(SIZE, rel=1e-5)
    assert np.abs(seen.max(axis=0) + seen.min(axis=0)).max() < 1e-3


def test_many_points_cover_no_more_than_few() -> None:
    assert point_size(100, 0.2) == point_size(6000, 0.2) == pytest.approx(0.002 * SIZE)
    assert 50_000 * point_size(50_000, 0.2) ** 2 == pytest.approx(6000 * point_size(6000, 0.2) ** 2)


def test_there_is_no_space_in_nothing() -> None:
    assert space_of(Frame()) is None
    assert space_of(Frame(points=np.array([[1.0, 2.0, 3.0]]))) is not None


# --- the film


def film(count: int, **more: object) -> Film:
    held = Film(**more)
    for number in range(count):
        held.add(Frame(f"{number}"))
    return held


def label(held: Film) -> str:
    frame = held.shown()
    assert frame is not None
    return frame.label


def test_it_follows_what_comes_until_paused_and_then_stands_still() -> None:
    held = film(3)
    assert label(held) == "2"
    held.toggle()
    held.add(Frame("3"))
    assert label(held) == "2"
    held.toggle()
    assert label(held) == "3"
    held.seek(1)
    held.add(Frame("4"))
    assert (label(held), held.playing) == ("1", False)


def test_afterwards_it_plays_from_the_first_to_the_last() -> None:
    held = film(3)
    assert not held.step()
    held.finish()
    assert not held.step()
    held.toggle()
    seen = [label(held)]
    while held.step():
        seen.append(label(held))
    assert seen == ["0", "1", "2"]
    assert not held.playing


def test_an_endless_stream_keeps_the_latest_and_moves_a_cursor_that_fell_off() -> None:
    held = film(3, keep=3)
    held.seek(0)
    for number in range(3, 8):
        held.add(Frame(f"{number}"))
    assert (len(held), held.first, held.last) == (3, 5, 7)
    assert label(held) == "5"
    held.seek(99)
    assert label(held) == "7"


def test_a_large_cloud_is_thinned_and_the_callers_array_left_alone() -> None:
    points = np.random.default_rng(0).normal(size=(60_000, 3))
    before = points.copy()
    held = Film()
    held.add(Frame(points=points))
    shown = held.shown()
    assert shown is not None
    assert shown.points is not None
    assert len(shown.points) == 50_000
    np.testing.assert_array_equal(points, before)


def dialled(count: int = 2) -> Film:
    held = Film(Dial("ε", 2.0, 1.0, 4.0))
    for number in range(count):
        held.add(Frame(f"{number}", again=lambda value: Frame(f"made {value}")))
    return held


def test_a_turned_dial_wants_the_frame_shown_and_each_only_once() -> None:
    held = dialled()
    held.turn(3.0)
    assert held.wanted() is None, "not while frames still come"
    held.finish()
    assert held.wanted() == (1, 3.0)
    held.made((1, 3.0), Frame("made"))
    assert held.wanted() is None
    assert label(held) == "made"
    held.seek(0)
    assert (held.wanted(), label(held)) == ((0, 3.0), "0")
    held.turn(2.0)
    assert (held.wanted(), label(held)) == (None, "0")
    held.seek(1)
    held.turn(3.0)
    assert (held.wanted(), label(held)) == (None, "made")


def test_turning_to_and_fro_does_not_fill_the_memory() -> None:
    held = dialled(1)
    held.keep = 5
    held.finish()
    for value in np.linspace(1, 4, 50):
        held.turn(float(value))
        held.made((0, float(value)), Frame("made"))
    assert len(held._made) == 5
    assert label(held) == "made"


# --- ε again


@pytest.mark.parametrize("config", ["default", "paper"])
def test_the_dial_stands_at_the_configured_epsilon(config: str) -> None:
    graph = build_graph(load_spec(config, {}))
    value = graph.stages["transport"].settings.epsilon
    dial = epsilon_dial(graph)
    assert dial is not None
    assert dial.low < dial.value == value < dial.high
    turned = with_epsilon(graph, 3 * value)
    assert epsilons(turned) == {"transport.epsilon": 3 * value}
    assert epsilons(graph) == {"transport.epsilon": value}


def test_an_impossible_epsilon_is_refused() -> None:
    with pytest.raises(ConfigError, match="epsilon"):
        with_epsilon(build_graph(load_spec("paper", {})), -1.0)


def test_a_frame_made_again_has_the_new_epsilon_and_the_old_cloud() -> None:
    graph = build_graph(load_spec("default", {}))
    cloud = as_point_cloud(demo_cloud(1500))
    frame = Frame("wolf", cloud.positions)
    again = remaker(graph, "skeleton", frame, lambda _: {"cloud": cloud})
    fine, coarse = again(1.5), again(6.0)
    assert fine.skeleton is not None
    assert coarse.skeleton is not None
    assert fine.label == "wolf"
    assert fine.points is cloud.positions
    assert fine.settings is not None
    assert fine.settings["transport"]["epsilon"] == 1.5
    assert len(coarse.skeleton) < len(fine.skeleton)
    # The same value gives the same skeleton: the dial has no memory.
    np.testing.assert_array_equal(again(1.5).skeleton.nodes, fine.skeleton.nodes)


# --- words


def test_names_of_files_are_no_markup() -> None:
    assert plain("a_b*[x](y)") == r"a\_b\*\[x\]\(y\)"
    held = film(1)
    assert r"\<script\>" in title_text(held, Frame("<script>"))


def test_the_title_counts_and_the_table_adds_up() -> None:
    timed = skeleton(Y.nodes, Y.edges, diagnostics={"seconds": {"seed": 0.25, "link": 0.5}})
    frame = Frame("a", np.zeros((7, 3)), timed)
    assert title_text(film(3), frame) == "**a**, frame 3 of 3"
    text = counts_text(frame)
    assert "points drawn 7" in text
    assert "ends 3" in text
    table = times_text(timed)
    assert "| seed | 250.0 |" in table
    assert "| **all stages** | **750.0** |" in table
    assert times_text(Y) == times_text(None) == ""


def test_the_legend_says_what_the_colours_mean() -> None:
    assert "grey" in legend_text(Y, "branch")
    assert legend_text(Y, "mass").startswith("mass: violet 0.0")
    assert legend_text(None, "mass") == ""


def test_downloads_are_named_after_the_frame() -> None:
    assert file_name("scan 7.ply") == "scan_7"
    assert file_name("../../etc/passwd") == "etc_passwd"
    assert file_name("") == file_name("...") == "skeleton"


# --- whom it answers


def test_a_port_that_is_taken_is_refused_if_named_and_passed_over_if_not() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match="cannot listen on port"):
            free_port("127.0.0.1", port)
    assert free_port("127.0.0.1", port) == port
    assert free_port("127.0.0.1", 0) > 0
    with socket.socket() as taken:
        try:
            taken.bind(("127.0.0.1", 8080))
        except OSError:
            pytest.skip("someone has 8080 already")
        taken.listen()
        assert free_port("127.0.0.1", None) > 8080


@pytest.mark.parametrize("host", ["203.0.113.7", "no.such.host.invalid"])
def test_an_address_of_another_machine_is_refused(host: str) -> None:
    with pytest.raises(InputError, match="no such address on this machine") as caught:
        free_port(host, 0)
    assert "127.0.0.1" in str(caught.value)


def test_addresses_are_written_as_a_browser_takes_them() -> None:
    assert page_url("0.0.0.0", 80) == "http://127.0.0.1:80"
    assert page_url("::1", 80) == "http://[::1]:80"
    assert page_url("robot.lan", 80) == "http://robot.lan:80"


@pytest.mark.parametrize(
    ("host", "local"),
    [
        *((name, True) for name in ("127.0.0.1", "localhost", "::1", "[::1]", "127.9.9.9")),
        *((name, False) for name in ("0.0.0.0", "192.168.1.2", "localhost.evil.example", "")),
    ],
)
def test_what_is_local(host: str, local: bool) -> None:
    assert is_local(host) is local


@pytest.mark.parametrize(
    ("host", "origin", "local", "own"),
    [
        ("127.0.0.1:8080", "http://127.0.0.1:8080", True, True),
        ("localhost:9000", "http://localhost:9000", True, True),
        ("127.0.0.1:8080", None, True, True),
        ("127.0.0.1:8080", "https://evil.example", True, False),
        ("127.0.0.1:8080", "http://127.0.0.1:3000", True, False),
        ("127.0.0.1:8080", "null", True, False),
        # A stranger's name that was made to point at this machine.
        ("evil.example:8080", "http://evil.example:8080", True, False),
        (None, None, True, False),
        ("robot.lan:8080", "http://robot.lan:8080", False, True),
        ("robot.lan:8080", "http://evil.example", False, False),
    ],
)
def test_only_its_own_page_is_answered(
    host: str | None, origin: str | None, local: bool, own: bool
) -> None:
    assert is_own_page(host, origin, local) is own


def test_without_viser_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "viser", None)
    with pytest.raises(MissingExtraError, match=r"viewer"):
        import_viser()
