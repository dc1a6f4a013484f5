"""Lengths, radii, loops and volumes of skeletons that are known by hand."""

from __future__ import annotations

import csv
import io
import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

import mdcs_pipeline as mdcs
from mdcs_pipeline.cli.app import app
from mdcs_pipeline.kernels.branches import split_branches
from mdcs_pipeline.kernels.loops import loop_basis
from mdcs_pipeline.messages import Header, Skeleton


def skeleton(nodes: Any, edges: Any, radius: Any = 0.5, mass: Any = None) -> Skeleton:
    nodes = np.array(nodes, float).reshape(-1, 3)
    count = len(nodes)
    return Skeleton(
        nodes=nodes,
        edges=np.sort(np.array(edges, np.int64).reshape(-1, 2), axis=1),
        mass=np.full(count, 1 / max(count, 1)) if mass is None else np.array(mass, float),
        radius=np.broadcast_to(np.array(radius, float), (count,)),
        node_ids=100 + np.arange(count),
        header=Header("map", 7, 3),
    )


def y() -> Skeleton:
    """Three limbs of two edges, of lengths 2, 4 and 6, that meet in node 0."""
    nodes = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 2, 0], [0, 4, 0], [0, 0, 3], [0, 0, 6]]
    return skeleton(nodes, [[0, 1], [1, 2], [0, 3], [3, 4], [0, 5], [5, 6]])


def ring(count: int = 8) -> Skeleton:
    turn = np.arange(count) * 2 * np.pi / count
    nodes = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    return skeleton(nodes, [[i, (i + 1) % count] for i in range(count)])


def theta() -> Skeleton:
    """Two junctions joined by three ways, of lengths 2, 2√2 and 4."""
    nodes = [[0, 0, 0], [2, 0, 0], [1, 1, 0], [0, -1, 0], [2, -1, 0]]
    return skeleton(nodes, [[0, 1], [0, 2], [2, 1], [0, 3], [3, 4], [4, 1]])


def test_y() -> None:
    found = mdcs.measure(y())
    assert found.summary == {
        "nodes": 7,
        "edges": 6,
        "components": 1,
        "cycles": 0,
        "leaves": 3,
        "junctions": 1,
        "isolated": 0,
        "branches": 3,
        "length": 12.0,
        "radius_min": 0.5,
        "radius_max": 0.5,
        "volume": pytest.approx(np.pi * 0.25 * 12),
    }
    assert [(b.start, b.end, b.length, b.nodes) for b in found.branches] == [
        (100, 102, 2.0, 3),
        (100, 104, 4.0, 3),
        (100, 106, 6.0, 3),
    ]
    assert {b.kind for b in found.branches} == {"end-junction"}
    # Two nodes of its own and a third of the junction.
    assert [b.mass for b in found.branches] == pytest.approx([(2 + 1 / 3) / 7] * 3)
    (junction,) = found.junctions
    assert (junction.node, junction.degree, junction.branches) == (100, 3, (0, 1, 2))
    assert found.loops == ()


def test_ring() -> None:
    found = mdcs.measure(ring())
    (branch,) = found.branches
    around = 8 * 2 * np.sin(np.pi / 8)
    assert (branch.kind, branch.start, branch.end, branch.nodes) == ("loop", 100, 100, 8)
    assert branch.length == pytest.approx(around)
    assert (branch.chord, branch.mass) == (0.0, pytest.approx(1.0))
    assert [loop.branches for loop in found.loops] == [(0,)]
    assert found.loops[0].length == pytest.approx(around)
    assert found.junctions == ()


def test_theta() -> None:
    """Of the three loops the two shortest are the basis."""
    found = mdcs.measure(theta())
    assert [b.length for b in found.branches] == pytest.approx([2, 2 * np.sqrt(2), 4])
    assert {b.kind for b in found.branches} == {"junction-junction"}
    assert {b.chord for b in found.branches} == {2.0}
    assert [loop.branches for loop in found.loops] == [(0, 1), (0, 2)]
    assert [loop.length for loop in found.loops] == pytest.approx([2 + 2 * np.sqrt(2), 6])


def test_a_loop_at_a_junction_and_two_pieces() -> None:
    """A lasso is a loop and a tail; a rod apart of it is a branch between two ends."""
    nodes = [[0, 0, 0], [1, 1, 0], [1, -1, 0], [-1, 0, 0], [5, 0, 0], [6, 0, 0]]
    found = mdcs.measure(skeleton(nodes, [[0, 1], [1, 2], [0, 2], [0, 3], [4, 5]]))
    assert sorted(b.kind for b in found.branches) == ["end-end", "end-junction", "loop"]
    (junction,) = found.junctions
    assert junction.degree == 3
    assert len(junction.branches) == 2
    (loop,) = found.loops
    assert loop.length == pytest.approx(2 + 2 * np.sqrt(2))


def test_isolated_nodes_are_balls() -> None:
    found = mdcs.measure(skeleton([[0, 0, 0], [9, 0, 0]], [], radius=[1, 2]))
    assert (found.branches, found.junctions, found.loops) == ((), (), ())
    assert (found.summary["isolated"], found.summary["length"]) == (2, 0.0)
    assert found.summary["volume"] == pytest.approx(4 / 3 * np.pi * 9)


def test_an_empty_skeleton() -> None:
    found = mdcs.measure(skeleton([], []))
    assert found.summary["volume"] == 0.0
    assert (found.summary["radius_min"], found.summary["radius_max"]) == (None, None)


def test_a_cone_has_its_volume_and_mean_radius() -> None:
    """Radii grow along the branch; unequal steps must not weigh on the mean."""
    places = np.array([0, 1, 6, 10.0])
    made = skeleton(
        np.stack([places, 0 * places, 0 * places], axis=1),
        [[0, 1], [1, 2], [2, 3]],
        radius=places / 10,
    )
    (branch,) = mdcs.measure(made).branches
    assert branch.volume == pytest.approx(np.pi * 10 / 3)
    assert branch.radius_mean == pytest.approx(0.5)
    assert (branch.radius_min, branch.radius_max) == (0.0, 1.0)


def test_nodes_in_one_place_divide_nothing_by_zero() -> None:
    (branch,) = mdcs.measure(skeleton([[1, 1, 1], [1, 1, 1]], [[0, 1]])).branches
    assert (branch.length, branch.radius_mean, branch.volume) == (0.0, 0.5, 0.0)


@st.composite
def graphs(draw: st.DrawFn) -> Skeleton:
    count = draw(st.integers(1, 10))
    pairs = [(i, j) for j in range(count) for i in range(j)]
    edges = draw(st.lists(st.sampled_from(pairs), unique=True)) if pairs else []
    rng = np.random.default_rng(draw(st.integers(0, 99)))
    return skeleton(rng.normal(size=(count, 3)), edges, rng.uniform(size=count))


@given(graphs())
def test_branches_and_loops_of_any_graph(made: Skeleton) -> None:
    """Branches share out edges, length and mass; loops are as short as networkx's."""
    found = mdcs.measure(made)
    paths = split_branches(len(made), made.edges)
    walked = [tuple(sorted(p)) for path in paths for p in pairwise(path.tolist())]
    assert sorted(walked) == sorted(map(tuple, made.edges.tolist()))
    degree = np.bincount(made.edges.ravel(), minlength=len(made))
    assert all(degree[i] == 2 for path in paths for i in path[1:-1])
    graph = made.to_networkx()
    assert found.summary["length"] == pytest.approx(graph.size(weight="length"))
    shared = sum(b.mass for b in found.branches) + made.mass[degree == 0].sum()
    assert shared == pytest.approx(1.0)
    basis = nx.minimum_cycle_basis(graph, weight="length")
    wanted = sum(nx.path_weight(graph, [*ring, ring[0]], "length") for ring in basis)
    assert len(found.loops) == len(basis) == found.summary["cycles"]
    assert sum(loop.length for loop in found.loops) == pytest.approx(wanted)


def test_equal_lengths_leave_no_loop_out() -> None:
    """A cube's graph: ties everywhere, five squares are the basis."""
    graph = nx.hypercube_graph(3)
    edges = np.array(list(nx.convert_node_labels_to_integers(graph).edges), np.int64)
    found = loop_basis(8, edges, np.ones(12))
    assert [len(loop) for loop in found] == [4] * 5


def test_networkx_graph_has_the_header() -> None:
    assert y().to_networkx().graph == {"frame_id": "map", "stamp_ns": 7, "seq": 3}


# --- mdcs info


def info(*args: object) -> Any:
    return CliRunner().invoke(app, ["info", *map(str, args)])


@pytest.fixture(params=[".json", ".npz"])
def saved(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    path = tmp_path / f"theta{request.param}"
    theta().save(path)
    return path


def test_info_as_json_is_all_there_is(saved: Path) -> None:
    done = info(saved, "--format", "json")
    found = json.loads(done.stdout)
    assert done.exit_code == 0
    assert found["header"] == {"frame_id": "map", "stamp_ns": 7, "seq": 3}
    assert found["summary"] == mdcs.measure(theta()).summary
    assert [b["length"] for b in found["branches"]] == pytest.approx([2, 8**0.5, 4])
    assert [loop["branches"] for loop in found["loops"]] == [[0, 1], [0, 2]]
    assert [j["node"] for j in found["junctions"]] == [100, 101]


@pytest.mark.parametrize(
    ("table", "rows", "name"),
    [("branches", 3, "length"), ("junctions", 2, "degree"), ("loops", 2, "length")],
)
def test_info_as_csv_is_one_table(saved: Path, table: str, rows: int, name: str) -> None:
    done = info(saved, "--format", "csv", "--table", table)
    found = list(csv.DictReader(io.StringIO(done.stdout)))
    measured = getattr(mdcs.measure(theta()), table)
    assert len(found) == rows
    # Every bit: the text reads back as the same number.
    assert [float(row[name]) for row in found] == [getattr(row, name) for row in measured]


def test_info_as_csv_of_the_summary(saved: Path) -> None:
    (row,) = csv.DictReader(
        io.StringIO(info(saved, "--format", "csv", "--table", "summary").stdout)
    )
    assert (row["branches"], row["cycles"]) == ("3", "2")


@pytest.mark.parametrize("columns", ["40", "200"])
def test_info_as_text_shows_the_tables_that_have_rows(
    saved: Path, tmp_path: Path, columns: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whole words at any width: a table once came out folded where COLUMNS was small."""
    monkeypatch.setenv("COLUMNS", columns)
    shown = info(saved).stdout
    assert "junction-junction" in shown
    assert "2.828" in shown
    skeleton([], []).save(tmp_path / "empty.json")
    empty = info(tmp_path / "empty.json")
    assert empty.exit_code == 0
    assert "chord" not in empty.stdout
    assert "radius min" in empty.stdout


@pytest.mark.parametrize("suffix", [".graphml", ".ply", ".swc"])
def test_formats_of_other_tools_are_read_back(tmp_path: Path, suffix: str) -> None:
    """What they hold of a skeleton comes back bit by bit; SWC's order is its own."""
    made = y() if suffix == ".swc" else theta()
    path = tmp_path / f"s{suffix}"
    made.save(path)
    back = Skeleton.load(path)
    wanted, found = mdcs.measure(made), mdcs.measure(back)
    assert found.summary == pytest.approx(wanted.summary)
    lengths = sorted(branch.length for branch in wanted.branches)
    assert sorted(branch.length for branch in found.branches) == lengths
    assert json.loads(info(path, "--format", "json").stdout)["summary"] == found.summary
    if suffix != ".swc":
        for name in ("nodes", "mass", "radius"):
            np.testing.assert_array_equal(getattr(back, name), getattr(made, name))
        assert sorted(back.edges.tolist()) == sorted(made.edges.tolist())
    if suffix == ".graphml":
        assert back.header == made.header
        np.testing.assert_array_equal(back.node_ids, made.node_ids)


@pytest.mark.parametrize("suffix", [".graphml", ".ply", ".swc"])
def test_empty_and_lone_skeletons_are_read_back(tmp_path: Path, suffix: str) -> None:
    for made in (skeleton([], []), skeleton([[1, 2, 3]], [])):
        made.save(tmp_path / f"s{suffix}")
        assert len(Skeleton.load(tmp_path / f"s{suffix}")) == len(made)


@pytest.mark.parametrize("suffix", [".graphml", ".ply", ".swc", ".json", ".npz"])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.8, 0.97])
def test_cut_off_files_are_refused_or_whole(tmp_path: Path, suffix: str, share: float) -> None:
    """Never a traceback, and never a part that goes for the whole, where the format can tell.

    SWC is lines alone: cut between two, it is a shorter tree.
    """
    path = tmp_path / f"s{suffix}"
    y().save(path)
    raw = path.read_bytes()
    path.write_bytes(raw[: int(share * len(raw))])
    done = info(path)
    assert "Traceback" not in done.stderr
    assert done.exit_code == 2 or suffix == ".swc"
    if done.exit_code == 2:
        assert path.name in done.stderr


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.graphml", "<graphml/>", "no skeleton in GraphML"),
        ("a.graphml", '<!DOCTYPE g [<!ENTITY a "b">]><graphml/>', "document type"),
        ("a.ply", "ply\nelement vertex 1\nelement edge 0\nend_header\n", "another layout"),
        ("a.swc", "1 0 a b c 1 -1\n", "no SWC"),
        ("a.swc", "1 0 0 0 0 1\n", "no SWC"),
        ("a.swc", "2 0 0 0 0 1 1\n", "cut off"),
        ("a.swc", "1 0 0 0 nan 1 -1\n", "finite"),
        ("a.swc", "1 0 0 0 0 1 -1\n1 0 0 0 0 1 -1\n", "unique"),
    ],
)
def test_what_is_no_skeleton_of_that_format(
    tmp_path: Path, name: str, text: str, said: str
) -> None:
    (tmp_path / name).write_text(text)
    done = info(tmp_path / name)
    assert done.exit_code == 2
    assert said in done.stderr


def test_info_refuses_what_is_no_skeleton(tmp_path: Path) -> None:
    np.savez(tmp_path / "cloud.npz", points=np.ones((3, 3)))
    (tmp_path / "s.ply").write_text("ply\n")
    for name in ("cloud.npz", "s.ply", "none.json"):
        done = info(tmp_path / name)
        assert done.exit_code == 2
        assert name in done.stderr
        assert "Traceback" not in done.stderr
