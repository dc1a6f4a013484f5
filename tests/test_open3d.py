"""Open3D's clouds into every stage that takes points, and skeletons out as its line sets."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes

import mdcs_pipeline as mdcs
from mdcs_pipeline.ingest import as_point_cloud
from mdcs_pipeline.messages import PointCloud, Skeleton
from mdcs_pipeline.stage import input_ports, stage_class, stage_names
from mdcs_pipeline.stages.clean import Clean
from mdcs_pipeline.stages.combine import Combine
from mdcs_pipeline.stages.density import Density
from mdcs_pipeline.stages.downsample import Downsample
from mdcs_pipeline.stages.thin import Thin
from mdcs_pipeline.stages.write import Write

o3d = pytest.importorskip("open3d", exc_type=ImportError)
ROOT = Path(__file__).parent.parent
POINTS = shapes.y(1000, 0)


def legacy(points: np.ndarray = POINTS) -> Any:
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


def tensor(points: np.ndarray = POINTS) -> Any:
    cloud = o3d.t.geometry.PointCloud()
    cloud.point.positions = o3d.core.Tensor(points)
    return cloud


def skeleton() -> Skeleton:
    return Skeleton(
        nodes=POINTS[:4],
        edges=np.array([[0, 1], [1, 2], [1, 3]]),
        mass=np.array([0.1, 0.2, 0.3, 0.4]),
        radius=np.array([1.0, 2.0, 3.0, 4.0]),
        node_ids=np.arange(4),
    )


# --- memory


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_tensor_is_looked_at_where_it_lies(dtype: type) -> None:
    """The message reads the tensor's memory, cannot write to it, and keeps it alive."""
    cloud = tensor(POINTS.astype(dtype))
    message = as_point_cloud(cloud)
    assert message.positions.dtype == dtype
    assert np.shares_memory(message.positions, cloud.point.positions.numpy())
    assert not message.positions.flags.writeable
    del cloud
    np.testing.assert_array_equal(message.positions, POINTS.astype(dtype))


def test_a_tensor_with_gaps_is_copied_into_a_row() -> None:
    """Kernels walk over contiguous rows."""
    cloud = tensor(np.repeat(POINTS, 2, axis=0))
    cloud.point.positions = cloud.point.positions[::2]
    message = as_point_cloud(cloud)
    assert message.positions.flags.c_contiguous
    np.testing.assert_array_equal(message.positions, POINTS)


def test_a_legacy_cloud_may_be_changed_after_it_was_taken() -> None:
    """Open3D frees the memory behind numpy's view when the points are replaced."""
    cloud = legacy()
    message = as_point_cloud(cloud)
    cloud.points = o3d.utility.Vector3dVector(np.full((100_000, 3), 7.0))
    cloud.clear()
    np.testing.assert_array_equal(message.positions, POINTS)


def test_nothing_of_the_users_is_changed() -> None:
    """A whole pipeline leaves both kinds of cloud as they were."""
    for cloud, points in ((legacy(), lambda c: c.points), (tensor(), lambda c: c.point.positions)):
        before = np.array(points(cloud))
        mdcs.skeletonize(cloud)
        np.testing.assert_array_equal(np.asarray(points(cloud)), before)


@pytest.mark.parametrize("as_tensor", [False, True])
def test_what_goes_out_is_in_memory_of_its_own(as_tensor: bool) -> None:
    """Open3D writes through to arrays that numpy has as read-only: messages must not be those."""
    made, cloud = skeleton(), PointCloud(POINTS)
    lines, points = made.to_lineset(as_tensor), cloud.to_open3d(as_tensor)
    lines.translate([1.0, 1.0, 1.0])
    points.translate([1.0, 1.0, 1.0])
    if as_tensor:
        lines.point.mass[0] = 9.0
    np.testing.assert_array_equal(made.nodes, POINTS[:4])
    np.testing.assert_array_equal(cloud.positions, POINTS)
    assert made.mass[0] == 0.1


# --- line sets and clouds


def test_a_tensor_line_set_carries_mass_and_radius() -> None:
    made = skeleton()
    lines = made.to_lineset(tensor=True)
    assert isinstance(lines, o3d.t.geometry.LineSet)
    np.testing.assert_array_equal(lines.point.positions.numpy(), made.nodes)
    np.testing.assert_array_equal(lines.line.indices.numpy(), made.edges)
    np.testing.assert_array_equal(lines.point.mass.numpy()[:, 0], made.mass)
    np.testing.assert_array_equal(lines.point.radius.numpy()[:, 0], made.radius)
    same = lines.to_legacy()
    np.testing.assert_array_equal(np.asarray(same.lines), made.edges)


def test_a_legacy_line_set_is_written_and_read_by_open3d(tmp_path: Path) -> None:
    made = skeleton()
    path = str(tmp_path / "lines.ply")
    assert o3d.io.write_line_set(path, made.to_lineset())
    back = o3d.io.read_line_set(path)
    np.testing.assert_allclose(np.asarray(back.points), made.nodes)
    np.testing.assert_array_equal(np.asarray(back.lines), made.edges)


def test_a_skeleton_without_edges_gives_an_empty_line_set() -> None:
    made = Skeleton(POINTS[:1], np.empty((0, 2), int), np.ones(1), np.ones(1), np.zeros(1, int))
    assert len(made.to_lineset().lines) == 0
    assert made.to_lineset(tensor=True).line.indices.shape == (0, 2)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_clouds_go_out_and_come_back(dtype: type) -> None:
    points = POINTS.astype(dtype)
    message = PointCloud(points)
    back = as_point_cloud(message.to_open3d(tensor=True)).positions
    assert back.dtype == dtype
    np.testing.assert_array_equal(back, points)
    np.testing.assert_array_equal(np.asarray(message.to_open3d().points), points)


# --- stages on clouds

CALLS: dict[str, Any] = {
    "clean": lambda cloud: Clean()(cloud).cloud.positions,
    "combine": lambda cloud: Combine()((cloud, cloud)).cloud.positions,
    "density": lambda cloud: Density()(cloud).cloud.positions,
    "downsample": lambda cloud: Downsample()(cloud).cloud.positions,
    "thin": lambda cloud: Thin(voxel=0.1, enough=0)(cloud).cloud.positions,
}


@pytest.mark.parametrize("make", [legacy, tensor, lambda: POINTS.tolist()])
@pytest.mark.parametrize("name", CALLS)
def test_stages_take_clouds_as_they_are(name: str, make: Any) -> None:
    """The same answer as for the message."""
    np.testing.assert_array_equal(CALLS[name](make()), CALLS[name](PointCloud(POINTS)))


def test_write_and_smooth_take_clouds_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The optional clouds: the one drawn behind, and the one whose points are assigned."""
    pytest.importorskip("matplotlib")
    Write(path=str(tmp_path / "s.png"))(skeleton(), legacy())
    assert (tmp_path / "s.png").stat().st_size > 1000
    pipe = mdcs.Pipeline.from_config("paper", smooth={"assign": True})
    taken: dict[str, Any] = {}
    smooth = pipe.graph.stages["smooth"]
    call = type(smooth).__call__

    def noted(self: Any, **given: Any) -> Any:
        taken.update(given)
        return call(self, **given)

    monkeypatch.setattr(type(smooth), "__call__", noted)
    wanted = pipe.push(POINTS).assignment
    got = smooth(**{**taken, "points": tensor()}).skeleton.assignment
    np.testing.assert_array_equal(got, wanted)


def test_no_stage_that_takes_points_is_left_out() -> None:
    """A new stage with a port for points must be callable on Open3D's as well."""
    taking = {
        name
        for name in stage_names()
        if any(port.type is PointCloud for port in input_ports(stage_class(name)).values())
    }
    # A scene's cloud comes with the time and frame that only the message has.
    assert taking == {*CALLS, "smooth", "write", "scene"}


@pytest.mark.parametrize("make", [legacy, tensor])
def test_a_stream_takes_clouds_as_they_are(make: Any) -> None:
    """The stage `scene` wants time and frame beside the points; `push` puts them there."""
    settings = {"scene.voxel_size": 0.05}
    streams = [mdcs.Stream.from_config("streaming", **settings) for _ in range(2)]
    points = shapes.y(3000, 0)
    for stream, cloud in zip(streams, (make(points), points), strict=True):
        stream.push(cloud, stamp_ns=5, frame_id="map")
    found, wanted = (stream.skeleton() for stream in streams)
    assert len(found)
    assert found.header == wanted.header
    np.testing.assert_array_equal(found.nodes, wanted.nodes)


@pytest.mark.parametrize("make", [legacy, tensor])
def test_points_that_are_not_finite_are_left_out_and_counted(make: Any) -> None:
    holed = np.concatenate([POINTS, [[np.nan, 0, 0]]])
    cloud = Downsample()(make(holed)).cloud
    assert cloud.dropped == 1
    np.testing.assert_array_equal(cloud.positions, Downsample()(POINTS).cloud.positions)


@pytest.mark.parametrize("cloud", [o3d.geometry.PointCloud(), o3d.t.geometry.PointCloud()])
def test_empty_clouds_are_refused_in_words(cloud: Any) -> None:
    with pytest.raises(mdcs.InputError, match="empty"):
        Downsample()(cloud)


def test_a_mesh_is_refused_in_words() -> None:
    with pytest.raises(mdcs.InputError, match="TriangleMesh"):
        Downsample()(o3d.geometry.TriangleMesh())


# --- the example


@pytest.mark.parametrize("given", [False, True])
def test_the_example_script(tmp_path: Path, given: bool) -> None:
    """As a user runs it, on its own scan and on a file."""
    scan = []
    if given:
        rng = np.random.default_rng(0)
        table = rng.uniform([-2, -2, 0], [2, 2, 0], (8000, 3))
        above = POINTS + np.array([0, 0, 0.2 - POINTS[:, 2].min()])
        points = np.concatenate([above, table])
        o3d.io.write_point_cloud(str(tmp_path / "scan.ply"), legacy(points))
        scan = [str(tmp_path / "scan.ply")]
    done = subprocess.run(
        [sys.executable, ROOT / "examples" / "open3d_script.py", *scan, "-o", tmp_path / "out"],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr
    assert f"'leaves': {3 if given else 6}" in done.stdout
    lines = o3d.io.read_line_set(str(tmp_path / "out" / "skeleton.ply"))
    assert len(lines.lines) > 10
    assert len(o3d.io.read_point_cloud(str(tmp_path / "out" / "object.ply")).points) > 100
