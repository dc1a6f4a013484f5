"""The front door: points of any kind in, skeletons out, and what an import costs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy import graph_of, toys

import mdcs_pipeline
from mdcs_pipeline import pipeline as pipeline_module
from mdcs_pipeline.errors import ConfigError, InputError, StageError
from mdcs_pipeline.graph import build_graph
from mdcs_pipeline.header import Header
from mdcs_pipeline.ingest import as_point_cloud
from mdcs_pipeline.messages import PointCloud
from mdcs_pipeline.pipeline import Pipeline, skeletonize

CORNER = """
name: toy
sources: {cloud: }
stages:
  size: {inputs: {cloud: sources.cloud}}
  until:
    inputs: {number: size.number}
    feedback: {number: {from: until.again, max_rounds: 2}}
    settings: {least: 100}
  corner: {inputs: {cloud: sources.cloud}}
results: {skeleton: corner.skeleton, count: until.number}
"""
TWO = """
sources: {left: , right: {nonfinite: refuse}}
stages:
  size: {inputs: {cloud: sources.left}}
  corner: {inputs: {cloud: sources.right}}
results: {shape: corner.skeleton, count: size.number}
"""
POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], np.float64)


def pipe_of(text: str = CORNER, **more: Any) -> Pipeline:
    return Pipeline(graph_of(text), **more)


# --- points


def fortran(points: Any) -> Any:
    return np.asfortranarray(points)


def strided(points: Any) -> Any:
    return np.repeat(np.repeat(points, 2, axis=0), 2, axis=1)[::2, ::2]


@pytest.mark.parametrize(
    "make",
    [
        lambda p: p,
        lambda p: p.tolist(),
        lambda p: p.astype(np.float32),
        lambda p: p.astype(np.float16),
        lambda p: p.astype(np.longdouble),
        lambda p: p.astype(np.int32),
        lambda p: p.astype(np.uint8),
        lambda p: p.astype(">f8"),
        fortran,
        strided,
        lambda p: p[::-1][::-1],
    ],
)
def test_points_of_any_type_and_layout_are_taken(make: Any) -> None:
    cloud = as_point_cloud(make(POINTS))
    assert cloud.positions.dtype in (np.dtype(np.float32), np.dtype(np.float64))
    np.testing.assert_array_equal(cloud.positions, POINTS)
    assert cloud.dropped == 0


def test_non_finite_points_are_dropped_with_a_count_or_refused() -> None:
    points = POINTS.copy()
    points[1, 2] = np.nan
    points[3, 0] = -np.inf
    cloud = as_point_cloud(points)
    np.testing.assert_array_equal(cloud.positions, POINTS[[0, 2]])
    assert cloud.dropped == 2
    with pytest.raises(InputError, match="2 of 4 points hold NaN or infinity"):
        as_point_cloud(points, nonfinite="refuse")
    with pytest.raises(InputError, match="all points hold NaN"):
        as_point_cloud(np.full((3, 3), np.nan))


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.empty((0, 3)), "the cloud is empty"),
        (PointCloud(np.empty((0, 3))), "the cloud is empty"),
        ([], "shape"),
        (np.zeros(3), r"shape \(3,\)"),
        (np.zeros((3, 2)), r"shape \(3, 2\)"),
        (np.zeros((2, 3, 3)), "shape"),
        (np.zeros((3, 3), complex), "real numbers"),
        ([["a", "b", "c"]], "real numbers"),
        ([[1, 2, 3], [1, 2]], "points"),
        ("cloud.ply", "real numbers"),
        (object(), "real numbers"),
    ],
)
def test_what_is_no_cloud_is_refused(points: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        as_point_cloud(points)


def test_the_callers_array_is_not_touched() -> None:
    points = POINTS.copy()
    points[0, 0] = np.nan
    before = points.copy()
    pipe_of().push(points)
    np.testing.assert_array_equal(points, before)
    assert points.flags.writeable


def test_a_message_keeps_what_is_not_given_anew() -> None:
    message = PointCloud(POINTS, np.ones(4), Header("lidar", 7, 3), dropped=1)
    assert as_point_cloud(message) is message
    header = as_point_cloud(message, Header("", 0, 5)).header
    assert header == Header("lidar", 7, 5)
    cloud = as_point_cloud(message, Header("map", 9, 5))
    assert cloud.header == Header("map", 9, 5)
    np.testing.assert_array_equal(cloud.weights, np.ones(4))
    assert cloud.dropped == 1


def test_open3d_clouds_are_taken() -> None:
    open3d = pytest.importorskip("open3d")
    legacy = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(POINTS))
    tensor = open3d.t.geometry.PointCloud(open3d.core.Tensor(POINTS.astype(np.float32)))
    for cloud, dtype in ((legacy, np.float64), (tensor, np.float32)):
        held = as_point_cloud(cloud)
        np.testing.assert_array_equal(held.positions, POINTS)
        assert held.positions.dtype == dtype
    with pytest.raises(InputError, match="empty"):
        as_point_cloud(open3d.geometry.PointCloud())


# --- frames


def test_a_push_gives_the_skeleton_with_its_header_and_record() -> None:
    points = np.vstack([POINTS, [[np.nan, 0, 0]]])
    with pipe_of() as pipe:
        first = pipe.push(points, stamp_ns=12, frame_id="map")
        second = pipe.push(POINTS)
    np.testing.assert_array_equal(first.nodes, POINTS[:2])
    assert first.header == Header("map", 12, 0)
    assert second.header == Header("", 0, 1)
    seconds = first.diagnostics.pop("seconds")
    assert list(seconds) == ["size", "until", "corner"]
    assert first.diagnostics == {
        "own": 1,
        "rounds": {"until.again -> until.number": 2},
        "exhausted": ["until.again -> until.number"],
        "dropped": 1,
    }
    assert pipe.last is not None
    assert pipe.last.results["skeleton"] is second
    assert pipe.last.results["count"].value == 4


def test_the_same_points_give_the_same_result() -> None:
    pipe = pipe_of()
    one, two = pipe.push(POINTS), pipe.push(POINTS)
    for name in ("nodes", "edges", "mass", "radius", "node_ids"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    figures = [{k: v for k, v in s.diagnostics.items() if k != "seconds"} for s in (one, two)]
    assert figures[0] == figures[1]


def test_a_refused_frame_leaves_the_pipeline_as_it_was() -> None:
    pipe = pipe_of()
    with pytest.raises(InputError, match="source 'cloud'"):
        pipe.push(np.empty((0, 3)))
    assert pipe.last is None
    assert pipe.push(POINTS).header.seq == 0


def test_several_sources_go_by_their_names() -> None:
    pipe = pipe_of(TWO.replace("shape", "skeleton"))
    for skeleton in (
        pipe.push(left=POINTS, right=POINTS + 1),
        pipe.push({"left": POINTS, "right": POINTS + 1}),
        pipe.push({"left": POINTS}, right=POINTS + 1),
    ):
        np.testing.assert_array_equal(skeleton.nodes, POINTS[:2] + 1)


def test_with_several_results_run_gives_them_all() -> None:
    record = pipe_of(TWO.replace("shape", "skeleton")).run(left=POINTS, right=POINTS)
    assert record.results["count"].value == 4
    assert len(record.results["skeleton"]) == 2


@pytest.mark.parametrize(
    ("arguments", "sources", "message"),
    [
        ((POINTS,), {}, "has 2 sources"),
        ((), {"left": POINTS}, "nothing was given for the source 'right'"),
        ((), {"left": POINTS, "rigth": POINTS}, "did you mean 'right'"),
        ((), {"left": POINTS, "right": POINTS * np.nan}, "source 'right'"),
    ],
)
def test_sources_that_do_not_fit_are_named(
    arguments: tuple[Any, ...], sources: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        pipe_of(TWO.replace("shape", "skeleton")).push(*arguments, **sources)


def test_a_graph_without_sources_takes_no_points() -> None:
    pipe = pipe_of("stages: {one: }\nresults: {n: one.number}")
    assert pipe.run().results["n"].value == 1
    assert pipe.push().value == 1
    with pytest.raises(InputError, match="takes its points from elsewhere"):
        pipe.push(POINTS)


def test_a_graph_with_no_such_result_says_so() -> None:
    with pytest.raises(StageError, match="no result called 'skeleton'") as caught:
        pipe_of(TWO).push(left=POINTS, right=POINTS)
    assert "shape, count" in str(caught.value)


def test_the_only_result_is_the_skeleton() -> None:
    pipe = pipe_of(
        "{sources: {cloud: }, stages: {corner: {inputs: {cloud: sources.cloud}}}, "
        "results: {shape: corner.skeleton}}"
    )
    assert len(pipe.push(POINTS)) == 2


def test_a_closed_pipeline_takes_nothing() -> None:
    with pipe_of() as pipe:
        pipe.push(POINTS)
    with pytest.raises(InputError, match="the pipeline is closed"):
        pipe.push(POINTS)
    with pytest.raises(InputError, match="the pipeline is closed"):
        pipe.run(cloud=POINTS)


# --- configurations


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "toy.yaml"
    path.write_text(CORNER)
    monkeypatch.setattr(pipeline_module, "build_graph", lambda spec: build_graph(spec, toys))
    return path


def test_a_skeleton_from_a_file_and_settings(config: Path) -> None:
    bound = "until.again -> until.number"
    assert skeletonize(POINTS, config).diagnostics["exhausted"] == [bound]
    for settings in ({"until": {"least": 4}}, {"until.least": 4}):
        skeleton = skeletonize(POINTS, str(config), **settings)
        assert skeleton.diagnostics["rounds"] == {bound: 0}
    with pytest.raises(InputError, match="NaN"):
        skeletonize([[np.nan, 0, 0]], config, **{"sources.cloud.nonfinite": "refuse"})


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"untl": {"least": 4}}, "did you mean 'until'"),
        ({"until": {"last": 4}}, "did you mean 'least'"),
        ({"least": 4}, "alone is no setting"),
    ],
)
def test_wrong_settings_are_refused(config: Path, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Pipeline.from_config(config, **settings)


def test_an_unknown_configuration_is_refused() -> None:
    with pytest.raises(ConfigError, match="unknown configuration 'nosuchthing'"):
        skeletonize(POINTS, "nosuchthing")


# --- the import


def python(code: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    return done.stdout.strip()


def test_the_import_is_light() -> None:
    """Only the slow modules are listed: which of them is loaded decides the time."""
    heavy = "numba open3d pydantic scipy networkx matplotlib numpy yaml typer rich k3d"
    code = (
        "import sys, time; began = time.perf_counter(); import mdcs_pipeline; "
        "took = time.perf_counter() - began; "
        f"print(sorted(set({heavy.split()}) & set(sys.modules)), took < 0.5)"
    )
    assert python(code) == "[] True"


def test_a_pipeline_does_not_load_open3d() -> None:
    code = (
        "import sys, mdcs_pipeline; mdcs_pipeline.Pipeline.from_config('default'); "
        "print('mdcs_pipeline.stages.transport' in sys.modules, 'open3d' in sys.modules)"
    )
    assert python(code) == "True False"


def test_all_names_are_there() -> None:
    for name in mdcs_pipeline.__all__:
        assert getattr(mdcs_pipeline, name) is not None
        assert name in dir(mdcs_pipeline)
    assert mdcs_pipeline.skeletonize is skeletonize
    assert mdcs_pipeline.Pipeline is Pipeline
    assert mdcs_pipeline.ConfigError is ConfigError
    assert mdcs_pipeline.Header is Header
    assert mdcs_pipeline.__version__[0].isdigit()
    with pytest.raises(AttributeError, match="no attribute 'skeletonise'"):
        mdcs_pipeline.skeletonise  # noqa: B018
