"""Skeleton files: what is written is the skeleton, whole or not at all."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import stat
import xml.etree.ElementTree as ET
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import BaseModel

from mdcs_pipeline.errors import ConfigError, InputError, OutputError
from mdcs_pipeline.header import Header
from mdcs_pipeline.io import record, write
from mdcs_pipeline.io.atomic import write_atomically
from mdcs_pipeline.io.plain import json_text, plain
from mdcs_pipeline.io.record import load_skeleton, package_version
from mdcs_pipeline.io.write import SKELETON_SUFFIXES, write_skeleton
from mdcs_pipeline.messages import PointCloud
from mdcs_pipeline.skeleton import Skeleton
from mdcs_pipeline.stage import input_ports, output_ports
from mdcs_pipeline.stages.write import Write

ARRAYS = ("nodes", "edges", "mass", "radius", "node_ids")
PLAIN = (".json", ".ply", ".graphml", ".npz", ".swc")


def skeleton(edges, count, seed=0, **fields):
    rng = np.random.default_rng(seed)
    mass = rng.random(count)
    return Skeleton(
        nodes=rng.normal(size=(count, 3)) + 1e6,
        edges=np.array(sorted(edges), np.int64).reshape(-1, 2),
        mass=mass / mass.sum() if count else mass,
        radius=rng.random(count),
        node_ids=rng.permutation(10 * count)[:count],
        **fields,
    )


@pytest.fixture
def wye():
    """Return a Y of seven nodes whose fork is node 2, and a lone node 7."""
    return skeleton(
        [(0, 1), (1, 2), (2, 3), (3, 4), (2, 5), (5, 6)],
        8,
        assignment=np.array([0, 3, 3, 7]),
        header=Header(frame_id="map", stamp_ns=1_700_000_000_123_456_789, seq=4),
        diagnostics={"rounds": np.int64(3), "error": math.nan, "energy": (1.5, np.float32(0.5))},
    )


@pytest.fixture
def loop():
    return skeleton([(0, 1), (1, 2), (2, 3), (0, 3)], 4)


@pytest.fixture
def nothing():
    return skeleton([], 0)


def assert_equal(left, right):
    for name in ARRAYS:
        mine, other = getattr(left, name), getattr(right, name)
        assert mine.dtype == other.dtype
        assert mine.shape == other.shape
        np.testing.assert_array_equal(mine, other)
    assert left.header == right.header
    if left.assignment is None:
        assert right.assignment is None
    else:
        np.testing.assert_array_equal(left.assignment, right.assignment)


# --- JSON and NPZ --------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".json", ".npz", ".JSON", ".Npz"])
def test_round_trip_is_exact(wye, tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    wye.save(path)
    back = Skeleton.load(path)
    assert_equal(wye, back)
    assert back.diagnostics == {"rounds": 3, "error": None, "energy": [1.5, 0.5]}


@pytest.mark.parametrize("suffix", [".json", ".npz"])
def test_round_trip_of_no_nodes_and_no_assignment(nothing, loop, tmp_path, suffix):
    for given_ in (nothing, loop):
        given_.save(tmp_path / f"a{suffix}")
        assert_equal(given_, Skeleton.load(str(tmp_path / f"a{suffix}")))


@settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    count=st.integers(1, 12),
    seed=st.integers(0, 99),
    frame=st.text(max_size=8),
    suffix=st.sampled_from([".json", ".npz"]),
)
def test_any_skeleton_survives(tmp_path, count, seed, frame, suffix):
    edges = [(i, i + 1) for i in range(count - 1)]
    one = skeleton(edges, count, seed, header=Header(frame_id=frame))
    one.save(tmp_path / f"a{suffix}")
    assert_equal(one, Skeleton.load(tmp_path / f"a{suffix}"))


@pytest.mark.parametrize("suffix", [".json", ".npz"])
def test_settings_and_version_are_kept(wye, tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    write_skeleton(wye, path, settings={"seed": {"count": np.int64(5), "path": Path("x")}})
    held = load_skeleton(path)
    assert held["settings"] == {"seed": {"count": 5, "path": "x"}}
    assert held["mdcs_pipeline"] == package_version()
    assert held["header"] == {"frame_id": "map", "stamp_ns": 1_700_000_000_123_456_789, "seq": 4}


def test_json_is_strict(wye, tmp_path):
    wye.save(tmp_path / "a.json")

    def refuse(name):
        raise AssertionError(name)

    held = json.loads((tmp_path / "a.json").read_text(), parse_constant=refuse)
    assert held["format"] == "mdcs-skeleton"
    assert held["format_version"] == 1
    assert held["nodes"] == wye.nodes.tolist()
    assert held["assignment"] == [0, 3, 3, 7]


def test_npz_needs_no_pickle(wye, tmp_path):
    wye.save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        assert all(archive[name].dtype.kind in "fiU" for name in archive.files)


def test_same_skeleton_same_bytes(wye, tmp_path):
    for suffix in PLAIN:
        wye.save(tmp_path / f"a{suffix}")
        wye.save(tmp_path / f"b{suffix}")
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_version_of_an_uninstalled_tree(monkeypatch):
    def absent(name):
        raise record.PackageNotFoundError(name)

    monkeypatch.setattr(record, "version", absent)
    assert package_version() == "unknown"


@dataclasses.dataclass
class Point:
    x: float
    y: object


class Model(BaseModel):
    path: Path = Path("a")


@pytest.mark.parametrize(
    ("value", "wanted"),
    [
        (True, True),
        (None, None),
        (math.inf, None),
        (np.float64("nan"), None),
        (np.bool_(True), True),
        (np.array([[1, 2], [3, 4]]), [[1, 2], [3, 4]]),
        (np.array(1.5), 1.5),
        ((1, [2.5]), [1, [2.5]]),
        ({3, 1, 2}, [1, 2, 3]),
        ({1: {"a": -math.inf}}, {"1": {"a": None}}),
        (Path("a/b"), "a/b"),
        (Point(1.0, Path("p")), {"x": 1.0, "y": "p"}),
        (Point, str(Point)),
        (Model(), {"path": "a"}),
        (1 + 2j, "(1+2j)"),
    ],
)
def test_plain(value, wanted):
    assert plain(value) == wanted
    assert json.loads(json_text(value)) == wanted


def edited(one, path, **changes):
    one.save(path)
    held = json.loads(path.read_text())
    held.update(changes)
    path.write_text(json.dumps({k: v for k, v in held.items() if v is not ...}, default=str))
    return path


BAD = {
    "foreign": ({"format": "other"}, "no skeleton file", "other"),
    "unnamed": ({"format": ...}, "no skeleton file", "no such key"),
    "later": ({"format_version": 2}, "format version 2", "upgrade"),
    "word": ({"format_version": "1"}, "'format_version' must be a whole number"),
    "true": ({"format_version": True}, "'format_version' must be a whole number"),
    "zero": ({"format_version": 0}, "'format_version' must be a whole number"),
    "no nodes": ({"nodes": ...}, "no 'nodes'"),
    "no header": ({"header": ...}, "no 'header'"),
    "header": ({"header": [1]}, "'header' must be a mapping"),
    "header field": ({"header": {"frame": "map"}}, "header:", "frame"),
    "seq": ({"header": {"seq": -1}}, "seq must be a non-negative integer"),
    "flat": ({"nodes": [[1, 2]] * 8}, "'nodes' must be float64", "(8, 2)"),
    "ragged": ({"nodes": [[1, 2, 3], [4]]}, "'nodes' is not an array"),
    "words": ({"mass": ["a"] * 8}, "'mass' must be float64"),
    "halves": ({"edges": [[0.5, 1]]}, "'edges' must be int64"),
    "mass": ({"mass": [1.0] * 8}, "mass must be non-negative and sum to 1"),
    "edges": ({"edges": [[0, 99]]}, "edges must name nodes 0 to 7"),
    "short": ({"radius": [1.0]}, "radius must have the shape (8)"),
    "assignment": ({"assignment": [8]}, "assignment must name nodes"),
}


@pytest.mark.parametrize("name", BAD)
def test_damaged_json_says_what_and_where(wye, tmp_path, name):
    changes, *words = BAD[name]
    path = edited(wye, tmp_path / "a.json", **changes)
    with pytest.raises(InputError) as caught:
        Skeleton.load(path)
    text = str(caught.value)
    assert text.startswith(str(path))
    for word in words:
        assert word in text, text


@pytest.mark.parametrize(
    ("name", "data", "word"),
    [
        ("a.json", b"{", "not JSON"),
        ("a.json", b"\xff\xfe", "not JSON"),
        ("a.json", b'{"format": NaN}', "NaN is no JSON number"),
        ("a.json", b"[" * 200_000, "not JSON"),
        ("a.json", b"[1, 2]", "no skeleton file"),
        ("a.npz", b"", "not an NPZ archive"),
        ("a.npz", b"PK\x03\x04 no", "not an NPZ archive"),
        ("a.npz", b"\x93NUMPY no", "not an NPZ archive"),
        ("a.png", b"png", "not read back from '.png'"),
        ("a.ply", b"ply", "no line set in PLY"),
    ],
)
def test_files_that_are_no_skeleton(tmp_path, name, data, word):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError) as caught:
        load_skeleton(tmp_path / name)
    assert word in str(caught.value)
    assert str(tmp_path / name) in str(caught.value)


def test_npz_of_something_else(tmp_path):
    np.savez(tmp_path / "a.npz", points=np.zeros((4, 3)))
    with pytest.raises(InputError, match="no skeleton file"):
        load_skeleton(tmp_path / "a.npz")
    np.save(tmp_path / "b.npz", np.zeros(3))
    np.savez(tmp_path / "c.npz", format=["a", "b"])
    (tmp_path / "b.npz.npy").rename(tmp_path / "b.npz")
    for name in ("b.npz", "c.npz"):
        with pytest.raises(InputError, match="not an NPZ archive of plain arrays"):
            load_skeleton(tmp_path / name)


def test_no_skeleton_file(tmp_path):
    for name in ("a.json", "a.npz"):
        with pytest.raises(InputError, match="cannot be read") as caught:
            Skeleton.load(tmp_path / name)
        assert name in str(caught.value)


# --- PLY, GraphML, SWC ---------------------------------------------------------------------


def read_ply(path):
    """Read our PLY by its header alone."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    counts = [int(line.split()[2]) for line in head.decode().splitlines() if "element" in line]
    names = [line.split()[2] for line in head.decode().splitlines() if "property double" in line]
    table = np.frombuffer(body, "<f8", counts[0] * len(names)).reshape(counts[0], len(names))
    edges = np.frombuffer(body, "<i4", offset=table.nbytes).reshape(counts[1], 2)
    return dict(zip(names, table.T, strict=True)), edges


def test_ply_is_exact(wye, nothing, tmp_path):
    for one in (wye, nothing):
        one.save(tmp_path / "a.ply")
        columns, edges = read_ply(tmp_path / "a.ply")
        assert list(columns) == ["x", "y", "z", "mass", "radius"]
        for name, column in zip("xyz", one.nodes.T, strict=True):
            np.testing.assert_array_equal(columns[name], column)
        np.testing.assert_array_equal(columns["mass"], one.mass)
        np.testing.assert_array_equal(columns["radius"], one.radius)
        np.testing.assert_array_equal(edges, one.edges)


def test_ply_opens_in_open3d(wye, tmp_path):
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    wye.save(tmp_path / "a.ply")
    lines = o3d.io.read_line_set(str(tmp_path / "a.ply"))
    np.testing.assert_array_equal(np.asarray(lines.points), wye.nodes)
    np.testing.assert_array_equal(np.asarray(lines.lines), wye.edges)


def test_lineset_of_a_skeleton(wye):
    pytest.importorskip("open3d", exc_type=ImportError)
    lines = wye.to_lineset()
    np.testing.assert_array_equal(np.asarray(lines.points), wye.nodes)


def test_graphml_is_exact(wye, tmp_path):
    wye.save(tmp_path / "a.graphml")
    graph = nx.read_graphml(tmp_path / "a.graphml", node_type=int)
    assert list(graph) == wye.node_ids.tolist()
    keys = ("x", "y", "z", "mass", "radius")
    table = np.array([[graph.nodes[n][key] for key in keys] for n in graph])
    np.testing.assert_array_equal(table, np.column_stack([wye.nodes, wye.mass, wye.radius]))
    ids = wye.node_ids.tolist()
    assert {frozenset(edge) for edge in graph.edges} == {
        frozenset((ids[i], ids[j])) for i, j in wye.edges
    }
    for i, j in wye.edges:
        length = math.dist(wye.nodes[i], wye.nodes[j])
        assert graph.edges[ids[i], ids[j]]["length"] == pytest.approx(length, rel=1e-12)
    assert graph.graph["frame_id"] == "map"
    assert graph.graph["stamp_ns"] == 1_700_000_000_123_456_789


@pytest.mark.parametrize("frame", ["a\x00b", "a\nb", "<&>\"'", "é", "\ud800"])
def test_odd_frame_ids_leave_files_that_open(tmp_path, frame):
    one = skeleton([(0, 1)], 2, header=Header(frame_id=frame))
    for suffix in PLAIN:
        one.save(tmp_path / f"a{suffix}")
    ET.parse(tmp_path / "a.graphml")
    assert Skeleton.load(tmp_path / "a.json").header.frame_id == frame
    data = [line for line in (tmp_path / "a.swc").read_text().splitlines() if line[0] != "#"]
    assert len(data) == 2


def read_swc(path):
    lines = [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]
    return [(int(a), int(b), *map(float, rest), int(p)) for a, b, *rest, p in lines]


def test_swc(wye, tmp_path):
    wye.save(tmp_path / "a.swc")
    table = read_swc(tmp_path / "a.swc")
    assert [row[0] for row in table] == list(range(1, 9))
    assert all(row[-1] == -1 or 1 <= row[-1] < row[0] for row in table)
    node = [int(np.flatnonzero((wye.nodes == row[2:5]).all(axis=1))[0]) for row in table]
    assert sorted(node) == list(range(8))
    assert [row[5] for row in table] == wye.radius[node].tolist()
    edges = {tuple(sorted((node[row[0] - 1], node[row[-1] - 1]))) for row in table if row[-1] != -1}
    assert edges == {tuple(pair) for pair in wye.edges.tolist()}
    kinds = {node[i]: row[1] for i, row in enumerate(table)}
    assert kinds == {0: 6, 1: 0, 2: 5, 3: 0, 4: 6, 5: 0, 6: 6, 7: 0}
    roots = {node[row[0] - 1] for row in table if row[-1] == -1}
    assert roots == {7, int(np.argmax(wye.radius[:7]))}


def test_swc_of_no_nodes(nothing, tmp_path):
    nothing.save(tmp_path / "a.swc")
    assert read_swc(tmp_path / "a.swc") == []


@settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.data())
def test_swc_of_any_forest_puts_parents_first(tmp_path, data):
    count = data.draw(st.integers(1, 15))
    parents = [data.draw(st.integers(-1, i - 1)) for i in range(count)]
    edges = [(p, i) for i, p in enumerate(parents) if p >= 0]
    one = skeleton(edges, count)
    one.save(tmp_path / "a.swc")
    table = read_swc(tmp_path / "a.swc")
    assert len(table) == count
    assert all(row[-1] < row[0] for row in table)
    assert sum(row[-1] == -1 for row in table) == count - len(edges)


def test_swc_of_a_deep_branch_needs_no_recursion(tmp_path):
    skeleton([(i, i + 1) for i in range(4999)], 5000).save(tmp_path / "a.swc")
    assert len(read_swc(tmp_path / "a.swc")) == 5000


def test_swc_refuses_loops(loop, tmp_path):
    with pytest.raises(OutputError) as caught:
        loop.save(tmp_path / "a.swc")
    text = str(caught.value)
    assert "1 independent loops" in text
    assert ".graphml" in text
    assert str(tmp_path / "a.swc") in text
    assert list(tmp_path.iterdir()) == []


# --- whole or not at all -------------------------------------------------------------------

FAULTS = [KeyboardInterrupt(), OSError(28, "No space left on device"), MemoryError()]


@pytest.mark.parametrize("suffix", PLAIN)
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: type(fault).__name__)
@pytest.mark.parametrize("step", ["fsync", "replace"])
@pytest.mark.parametrize("older", [False, True])
def test_interrupted_write_leaves_all_as_it_was(
    wye, tmp_path, monkeypatch, suffix, fault, step, older
):
    path = tmp_path / f"a{suffix}"
    if older:
        path.write_bytes(b"older")

    def fail(*args, **kwargs):
        raise fault

    with monkeypatch.context() as patch:
        patch.setattr(os, step, fail)
        wanted = OutputError if isinstance(fault, OSError) else type(fault)
        with pytest.raises(wanted) as caught:
            wye.save(path)
    if wanted is OutputError:
        assert "No space left" in str(caught.value)
        assert str(path) in str(caught.value)
    assert [item.name for item in tmp_path.iterdir()] == ([path.name] if older else [])
    if older:
        assert path.read_bytes() == b"older"


@pytest.mark.parametrize("suffix", [".png", ".html"])
def test_interrupted_picture_leaves_nothing(wye, tmp_path, monkeypatch, suffix):
    for module in ("matplotlib", "k3d"):
        pytest.importorskip(module)

    def fail(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(KeyboardInterrupt):
        wye.save(tmp_path / f"a{suffix}")
    assert list(tmp_path.iterdir()) == []


def test_fault_while_encoding_leaves_nothing(wye, tmp_path, monkeypatch):
    def fail(*args):
        raise KeyboardInterrupt

    monkeypatch.setitem(write._ENCODERS, ".json", fail)
    with pytest.raises(KeyboardInterrupt):
        wye.save(tmp_path / "a.json")
    assert list(tmp_path.iterdir()) == []


def test_fault_once_the_file_is_open_leaves_nothing(tmp_path):
    with pytest.raises(TypeError):
        write_atomically(tmp_path / "a.json", "no bytes")
    assert list(tmp_path.iterdir()) == []


def test_older_file_is_replaced_and_its_links_stay(wye, tmp_path):
    (tmp_path / "real").mkdir()
    target, link = tmp_path / "real" / "a.json", tmp_path / "link.json"
    target.write_text("older")
    link.symlink_to(target)
    wye.save(link)
    assert link.is_symlink()
    assert_equal(wye, Skeleton.load(target))
    assert [item.name for item in target.parent.iterdir()] == ["a.json"]


def test_mode_follows_the_umask(wye, tmp_path):
    before = os.umask(0o027)
    try:
        wye.save(tmp_path / "a.json")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.json").stat().st_mode) == 0o640


def test_places_that_cannot_be_written(wye, tmp_path, monkeypatch):
    cases = {
        tmp_path / "a.obj": ("suffix '.obj'", *SKELETON_SUFFIXES),
        tmp_path / "a": ("suffix ''",),
        tmp_path / "no" / "a.json": (f"no folder {tmp_path / 'no'}", "make the folder"),
        tmp_path / f"{'a' * 300}.json": ("cannot be written", "too long"),
    }
    for path, words in cases.items():
        with pytest.raises(OutputError) as caught:
            wye.save(path)
        for word in words:
            assert word in str(caught.value)
    (tmp_path / "b.json").mkdir()
    with pytest.raises(OutputError, match="a folder is in the file's place"):
        wye.save(tmp_path / "b.json")
    monkeypatch.setattr(os, "access", lambda *args: False)
    with pytest.raises(OutputError, match="no permission"):
        wye.save(tmp_path / "c.json")
    assert [item.name for item in tmp_path.iterdir()] == ["b.json"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_folder_without_permission(wye, tmp_path):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(OutputError, match="no permission"):
            wye.save(tmp_path / "a.json")
    finally:
        tmp_path.chmod(0o700)


def test_skeleton_is_not_changed(wye, tmp_path):
    before = {name: getattr(wye, name).copy() for name in ARRAYS}
    for suffix in PLAIN:
        wye.save(tmp_path / f"a{suffix}")
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(wye, name), value)
    assert math.isnan(wye.diagnostics["error"])


# --- the stage -----------------------------------------------------------------------------


def test_write_stage(wye, tmp_path):
    stage = Write(path=tmp_path / "a.json")
    assert stage(wye) is None
    assert stage(skeleton=wye, cloud=PointCloud(wye.nodes)) is None
    assert_equal(wye, Skeleton.load(tmp_path / "a.json"))
    ports = input_ports(Write)
    assert {name: port.optional for name, port in ports.items()} == {
        "skeleton": False,
        "cloud": True,
    }
    assert (ports["skeleton"].type, ports["cloud"].type) == (Skeleton, PointCloud)
    assert output_ports(Write) == {}


def test_write_stage_hands_the_cloud_on(wye, tmp_path, monkeypatch):
    seen = {}

    def remember(one, cloud, settings):
        seen["cloud"] = cloud
        return b"x"

    monkeypatch.setitem(write._ENCODERS, ".png", remember)
    cloud = PointCloud(wye.nodes)
    Write(path=tmp_path / "a.png")(wye, cloud)
    assert seen["cloud"] is cloud.positions


def test_write_settings(tmp_path):
    with pytest.raises(ConfigError, match="path"):
        Write()
    with pytest.raises(ConfigError) as caught:
        Write(path=tmp_path / "a.obj")
    assert ".graphml" in str(caught.value)
    assert all(item.description for item in Write.Settings.model_fields.values())
