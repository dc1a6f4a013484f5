"""Bags of ROS 1 and 2: what others wrote is read, and what we wrote is read by others."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from mdcs_pipeline.cli.app import app
from mdcs_pipeline.demo import demo_cloud
from mdcs_pipeline.errors import InputError, OutputError
from mdcs_pipeline.io.bag_writer import BagWriter
from mdcs_pipeline.io.bags import BagFrames, bag_topics, is_bag
from mdcs_pipeline.io.markers import DELETE, EDGES, NODES, MarkerHistory, skeleton_markers
from mdcs_pipeline.io.point_cloud2 import encode_points
from mdcs_pipeline.io.pose_track import PoseTrack
from mdcs_pipeline.messages import Header, Skeleton

pytest.importorskip("rosbags")
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

SECOND = 10**9
BASE = 1_700_000_000 * SECOND
POINTS = np.array([[1.5, -2.0, 3.25], [np.nan, 0.0, 1.0], [4.0, 5.0, 6.0]], np.float32)
QUARTER = (0.0, 0.0, 0.5**0.5, 0.5**0.5)
KINDS = ("mcap", "sqlite3", "ros1")


class Recorder:
    """Records a bag as a robot would, apart from the code under test."""

    def __init__(self, folder: Path, kind: str) -> None:
        self.ros1 = kind == "ros1"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        self.path = folder / ("bag.bag" if self.ros1 else "bag")
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        self.writer: Any = (
            Writer1(self.path)
            if self.ros1
            else Writer2(self.path, version=8, storage_plugin=plugin)
        )
        self.topics: dict[str, Any] = {}

    def __enter__(self) -> Recorder:
        self.writer.open()
        return self

    def __exit__(self, *error: object) -> None:
        self.writer.close()

    def type(self, name: str) -> Any:
        return self.store.types[name]

    def header(self, stamp: int, frame: str) -> Any:
        time = self.type("builtin_interfaces/msg/Time")(stamp // SECOND, stamp % SECOND)
        number = (0,) if self.ros1 else ()
        return self.type("std_msgs/msg/Header")(*number, time, frame)

    def add(self, topic: str, kind: str, when: int, *parts: Any) -> None:
        if topic not in self.topics:
            self.topics[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        write = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        self.writer.write(self.topics[topic], when, write(self.type(kind)(*parts), kind))

    def cloud(
        self,
        stamp: int,
        points: np.ndarray = POINTS,
        topic: str = "/lidar",
        frame: str = "lidar",
        when: int | None = None,
        **changes: Any,
    ) -> None:
        """A cloud as drivers lay it out: with intensity, ring and two bytes of padding."""
        layout = np.dtype(
            {
                "names": ["x", "y", "z", "intensity", "ring"],
                "formats": [">f4", ">f4", ">f4", ">f4", ">u2"],
                "offsets": [0, 4, 8, 16, 20],
                "itemsize": 24,
            }
        )
        rows = np.zeros(len(points), layout)
        for k, name in enumerate("xyz"):
            rows[name] = points[:, k]
        field = self.type("sensor_msgs/msg/PointField")
        names = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 16, 7), ("ring", 20, 4)]
        fields = [field(name, offset, kind, 1) for name, offset, kind in names]
        data = np.frombuffer(rows.tobytes(), np.uint8)
        values = {"data": data, "step": 24, **changes}
        self.add(
            topic,
            "sensor_msgs/msg/PointCloud2",
            stamp if when is None else when,
            self.header(stamp, frame),
            1,
            len(points),
            fields,
            True,
            values["step"],
            24 * len(points),
            values["data"],
            False,
        )

    def pose(
        self,
        stamp: int,
        place: tuple[float, float, float],
        turn: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
        kind: str = "geometry_msgs/msg/PoseStamped",
        frame: str = "odom",
    ) -> None:
        pose = self.type("geometry_msgs/msg/Pose")(
            self.type("geometry_msgs/msg/Point")(*place),
            self.type("geometry_msgs/msg/Quaternion")(*turn),
        )
        header = self.header(stamp, frame)
        if kind == "nav_msgs/msg/Odometry":
            spread = np.zeros(36)
            zero = self.type("geometry_msgs/msg/Vector3")(0.0, 0.0, 0.0)
            twist = self.type("geometry_msgs/msg/Twist")(zero, zero)
            self.add(
                "/pose",
                kind,
                stamp,
                header,
                "base",
                self.type("geometry_msgs/msg/PoseWithCovariance")(pose, spread),
                self.type("geometry_msgs/msg/TwistWithCovariance")(twist, spread),
            )
        else:
            self.add("/pose", kind, stamp, header, pose)


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    found: str = request.param
    return found


# --- reading


def test_clouds_of_every_kind_of_bag(tmp_path: Path, kind: str) -> None:
    """Big-endian, padded, with NaN; time and frame are the header's."""
    with Recorder(tmp_path, kind) as bag:
        for k in range(3):
            bag.cloud(BASE + k * SECOND + 7, POINTS + k, when=BASE + (10 + k) * SECOND)
    assert is_bag(bag.path)
    found = BagFrames(bag.path)
    assert (found.topic.name, len(found)) == ("/lidar", 3)
    for _ in range(2):
        frames = list(found)
        assert [f.stamp_ns for f in frames] == [BASE + k * SECOND + 7 for k in range(3)]
        assert {f.frame_id for f in frames} == {"lidar"}
        for k, frame in enumerate(frames):
            np.testing.assert_array_equal(frame.points, POINTS + k)
            assert frame.pose is None
    (last,) = found.since(2)
    np.testing.assert_array_equal(last.points, POINTS + 2)


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_the_file_inside_a_bag_is_one_too(tmp_path: Path, kind: str) -> None:
    with Recorder(tmp_path, kind) as bag:
        bag.cloud(BASE)
    (inside,) = (p for p in bag.path.iterdir() if p.suffix in (".mcap", ".db3"))
    alone = Path(shutil.copy(inside, tmp_path / f"alone{inside.suffix}"))
    assert is_bag(alone)
    assert [f.stamp_ns for f in BagFrames(alone)] == [BASE]


def test_a_bag_without_definitions_of_its_messages(tmp_path: Path) -> None:
    """As ROS 2 recorded them before Iron: types come from the store of the distribution."""
    import sqlite3

    with Recorder(tmp_path, "sqlite3") as bag:
        bag.cloud(BASE)
    (inside,) = bag.path.glob("*.db3")
    with sqlite3.connect(inside) as held:
        held.execute("DELETE FROM message_definitions")
        held.commit()
    held.close()
    (frame,) = BagFrames(bag.path)
    np.testing.assert_array_equal(frame.points, POINTS)


def test_a_stamp_of_zero_is_the_time_of_recording(tmp_path: Path, kind: str) -> None:
    with Recorder(tmp_path, kind) as bag:
        bag.cloud(0, when=BASE + 5)
    assert [f.stamp_ns for f in BagFrames(bag.path)] == [BASE + 5]


def test_clouds_without_points_come_through(tmp_path: Path, kind: str) -> None:
    with Recorder(tmp_path, kind) as bag:
        bag.cloud(BASE, POINTS[:0])
        bag.cloud(BASE + 1)
    assert [len(f.points) for f in BagFrames(bag.path)] == [0, 3]


def test_topics_are_chosen_by_name(tmp_path: Path, kind: str) -> None:
    with Recorder(tmp_path, kind) as bag:
        bag.cloud(BASE, topic="/front")
        bag.cloud(BASE, POINTS * 2, topic="/rear")
        bag.pose(BASE, (0, 0, 0))
    assert [(t.name, t.messages) for t in bag_topics(bag.path)] == [
        ("/front", 1),
        ("/pose", 1),
        ("/rear", 1),
    ]
    (rear,) = BagFrames(bag.path, "/rear")
    np.testing.assert_array_equal(rear.points, POINTS * 2)
    for topic, poses, text in (
        (None, None, "2 topics of PointCloud2"),
        ("/reer", None, "did you mean '/rear'"),
        ("/pose", None, "is no PointCloud2"),
        ("/rear", "/front", "is no PoseStamped"),
        ("/rear", "/odom", "no topic '/odom'"),
    ):
        with pytest.raises(InputError, match=text):
            BagFrames(bag.path, topic, poses=poses)


@pytest.mark.parametrize("type_", ["geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Odometry"])
def test_poses_stand_beside_the_clouds(tmp_path: Path, kind: str, type_: str) -> None:
    """Halfway in time is halfway along, and half of a quarter turn."""
    with Recorder(tmp_path, kind) as bag:
        bag.cloud(BASE - SECOND)
        bag.pose(BASE, (0.0, 0.0, 0.0), kind=type_)
        bag.cloud(BASE + SECOND // 20)
        bag.pose(BASE + SECOND // 10, (2.0, 4.0, 0.0), QUARTER, kind=type_)
        bag.cloud(BASE + SECOND // 10)
        bag.cloud(BASE + SECOND // 5)
    found = BagFrames(bag.path, poses="/pose")
    half, full, after = list(found)
    assert found.pose_frame == "odom"
    assert found.skipped == 1
    c = 0.5**0.5
    wanted = np.array([[c, -c, 0, 1], [c, c, 0, 2], [0, 0, 1, 0], [0, 0, 0, 1]])
    np.testing.assert_allclose(half.pose, wanted, atol=1e-12)
    wanted = np.array([[0, -1, 0, 2], [1, 0, 0, 4], [0, 0, 1, 0], [0, 0, 0, 1]])
    np.testing.assert_allclose(full.pose, wanted, atol=1e-12)
    # Within the tolerance behind the last one.
    np.testing.assert_allclose(after.pose, wanted, atol=1e-12)
    strict = BagFrames(bag.path, poses="/pose", unposed="refuse")
    with pytest.raises(InputError, match="no pose is near"):
        list(strict)


def test_poses_in_two_frames_are_refused(tmp_path: Path) -> None:
    with Recorder(tmp_path, "mcap") as bag:
        bag.cloud(BASE)
        bag.pose(BASE, (0, 0, 0))
        bag.pose(BASE, (0, 0, 0), frame="map")
    with pytest.raises(InputError, match="several frames"):
        list(BagFrames(bag.path, poses="/pose"))


def test_a_wrong_cloud_says_where_it_is(tmp_path: Path, kind: str) -> None:
    with Recorder(tmp_path, kind) as bag:
        bag.cloud(BASE)
        bag.cloud(BASE + 1, data=np.zeros(10, np.uint8))
    frames = iter(BagFrames(bag.path))
    next(frames)
    with pytest.raises(InputError, match="message 1: the cloud has fewer bytes"):
        next(frames)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.9])
def test_damaged_bags_are_refused_in_words(tmp_path: Path, kind: str, share: float) -> None:
    """Cut off anywhere: an error that names the bag, or every cloud that was there."""
    with Recorder(tmp_path, kind) as bag:
        for k in range(20):
            bag.cloud(BASE + k, np.zeros((2000, 3)))
    inside = bag.path if bag.ros1 else next(p for p in bag.path.iterdir() if p.suffix != ".yaml")
    raw = inside.read_bytes()
    inside.write_bytes(raw[: int(share * len(raw))])
    with pytest.raises(InputError, match="bag"):
        list(BagFrames(bag.path))


def test_what_is_no_bag(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "text.mcap").write_text("no bag at all, but long enough to be read as one")
    assert not is_bag(tmp_path / "folder")
    assert not is_bag(tmp_path / "cloud.ply")
    for name in ("folder", "text.mcap", "none.bag"):
        with pytest.raises(InputError, match=name):
            BagFrames(tmp_path / name)


# --- poses


@given(st.integers(0, 10**9), st.floats(-3.1, 3.1), st.floats(-100, 100))
def test_between_two_poses(offset: int, angle: float, way: float) -> None:
    """Nanoseconds since 1970 are more than a float64 can tell apart; the share is exact."""
    turn = (0.0, 0.0, np.sin(angle / 2), np.cos(angle / 2))
    track = PoseTrack([BASE + SECOND, BASE], [[way, 0, 0], [0, 0, 0]], [turn, (0, 0, 0, 1)])
    found = track.at(BASE + offset, SECOND)
    assert found is not None
    share = offset / SECOND
    c, s = np.cos(share * angle), np.sin(share * angle)
    wanted = [[c, -s, 0, share * way], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_the_last_of_equal_stamps_counts() -> None:
    track = PoseTrack([5, 5], [[1, 0, 0], [2, 0, 0]], [(0, 0, 0, 1)] * 2)
    found = track.at(5, 0)
    assert found is not None
    assert found[0, 3] == 2
    assert track.at(6, 0) is None


@pytest.mark.parametrize(
    ("place", "turn"),
    [((np.nan, 0, 0), (0, 0, 0, 1)), ((0, 0, 0), (0, 0, 0, 0)), ((0, 0, 0), (1, 1, 1, 1))],
)
def test_what_is_no_pose(place: Any, turn: Any) -> None:
    with pytest.raises(InputError, match="the pose is no rigid motion"):
        PoseTrack([0], [place], [turn])
    with pytest.raises(InputError, match="1 of 2 poses are no rigid motions"):
        PoseTrack([0, 1], [(0, 0, 0), place], [(0, 0, 0, 1), turn])


# --- writing


def skeleton(count: int = 4, first: int = 0, stamp: int = BASE) -> Skeleton:
    rng = np.random.default_rng(0)
    return Skeleton(
        nodes=rng.normal(size=(count, 3)),
        edges=np.array([[i, i + 1] for i in range(count - 1)], np.int64).reshape(-1, 2),
        mass=np.full(count, 1 / max(count, 1)),
        radius=np.ones(count),
        node_ids=first + np.arange(count),
        header=Header("map", stamp),
    )


PLACES = [("out.mcap", "mcap"), ("out", "mcap"), ("out", "sqlite3")]


@pytest.mark.parametrize(("name", "storage"), PLACES)
def test_written_bags_are_read_back(tmp_path: Path, name: str, storage: Any) -> None:
    pose = np.eye(4)
    pose[:3, 3] = 1, 2, 3
    with BagWriter(tmp_path / name, storage) as bag:
        for k in range(2):
            bag.add_cloud(POINTS, BASE + k, "lidar", columns={"mass": np.ones(3)})
            bag.add_pose(pose, BASE + k, "odom")
            bag.add_skeleton(skeleton(stamp=BASE + k))
    assert [p.name for p in tmp_path.iterdir()] == [name]
    found = BagFrames(tmp_path / name, poses="/pose")
    frames = list(found)
    assert [(f.stamp_ns, f.frame_id) for f in frames] == [(BASE, "lidar"), (BASE + 1, "lidar")]
    np.testing.assert_array_equal(frames[1].points, POINTS)
    np.testing.assert_allclose(frames[1].pose, pose)


@pytest.mark.parametrize("name", ["out.mcap", "out"])
def test_others_parsers_open_the_bag_by_its_own_schemas(tmp_path: Path, name: str) -> None:
    """mcap and mcap-ros2-support know no ROS message but by the definitions in the file.

    That is how Foxglove opens it. Every field of every message is decoded.
    """
    reader = pytest.importorskip("mcap.reader")
    decoder = pytest.importorskip("mcap_ros2.decoder")
    made = skeleton()
    with BagWriter(tmp_path / name) as bag:
        bag.add_cloud(POINTS, BASE, "lidar", columns={"mass": np.ones(3, np.float32)})
        bag.add_skeleton(made)
    path = tmp_path / name
    path = path if path.is_file() else next(path.glob("*.mcap"))
    with path.open("rb") as stream:
        opened = reader.make_reader(stream, decoder_factories=[decoder.DecoderFactory()])
        assert opened.get_header().profile == "ros2"
        found = {c.topic: (s, m) for s, c, _, m in opened.iter_decoded_messages()}
    schema, cloud = found["/points"]
    assert (schema.name, schema.encoding) == ("sensor_msgs/msg/PointCloud2", "ros2msg")
    assert [(f.name, f.offset, f.datatype, f.count) for f in cloud.fields] == [
        ("x", 0, 7, 1),
        ("y", 4, 7, 1),
        ("z", 8, 7, 1),
        ("mass", 12, 7, 1),
    ]
    assert (cloud.header.frame_id, cloud.width, cloud.is_dense) == ("lidar", 3, False)
    assert (
        bytes(cloud.data) == encode_points(POINTS, {"mass": np.ones(3, np.float32)}).data.tobytes()
    )
    schema, array = found["/skeleton"]
    assert schema.name == "visualization_msgs/msg/MarkerArray"
    lines = next(m for m in array.markers if m.ns == EDGES)
    assert (lines.type, lines.action, lines.pose.orientation.w) == (5, 0, 1.0)
    assert lines.scale.x > 0
    ends = [(p.x, p.y, p.z) for p in lines.points]
    np.testing.assert_array_equal(ends, made.nodes[made.edges.ravel()])
    assert sorted(m.id for m in array.markers if m.ns == NODES) == made.node_ids.tolist()
    assert {m.header.frame_id for m in array.markers} == {"map"}
    assert {(m.header.stamp.sec, m.header.stamp.nanosec) for m in array.markers} == {
        (BASE // SECOND, 0)
    }


def test_types_have_the_hashes_of_ros(tmp_path: Path) -> None:
    """The hashes by which ROS 2 tells message types apart, as its own files list them."""
    with BagWriter(tmp_path / "out") as bag:
        bag.add_cloud(POINTS, BASE)
        bag.add_skeleton(skeleton())
    text = (tmp_path / "out" / "metadata.yaml").read_text()
    assert "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5" in text
    with AnyReader([tmp_path / "out"]) as reader:
        assert {c.msgtype for c in reader.connections} == {
            "sensor_msgs/msg/PointCloud2",
            "visualization_msgs/msg/MarkerArray",
        }


def test_a_failure_leaves_nothing(tmp_path: Path) -> None:
    """Neither a part of the bag nor its scratch folder; an older file stays."""
    old = tmp_path / "old.mcap"
    old.write_bytes(b"old")
    for name in ("out", "new.mcap", "old.mcap"):
        with pytest.raises(RuntimeError), BagWriter(tmp_path / name) as bag:
            bag.add_cloud(POINTS, BASE)
            raise RuntimeError
    assert [p.name for p in tmp_path.iterdir()] == ["old.mcap"]
    assert old.read_bytes() == b"old"


def test_places_that_are_refused(tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "file").write_text("")
    for name, text in (
        ("taken", "place is taken"),
        ("file", "place is taken"),
        ("none/out", "no folder"),
    ):
        with pytest.raises(OutputError, match=text):
            BagWriter(tmp_path / name)
    with pytest.raises(OutputError, match="lone"):
        BagWriter(tmp_path / "a.mcap", "sqlite3")


def test_an_empty_bag_is_a_bag(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "out.mcap"):
        pass
    assert bag_topics(tmp_path / "out.mcap") == []


def test_no_frame_is_written_as_map(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "out.mcap") as bag:
        bag.add_cloud(POINTS, BASE)
    assert [f.frame_id for f in BagFrames(tmp_path / "out.mcap")] == ["map"]


# --- markers


def test_markers_that_vanish_are_deleted() -> None:
    history = MarkerHistory()
    history.show(skeleton(4, first=0))
    second = history.show(skeleton(4, first=2))
    gone = [(m.ns, m.id) for m in second if m.action == DELETE]
    assert gone == [(NODES, 0), (NODES, 1)]
    third = history.show(skeleton(0))
    assert {(m.ns, m.id) for m in third} == {(NODES, k) for k in (2, 3, 4, 5)} | {(EDGES, 0)}
    assert {m.action for m in third} == {DELETE}
    assert history.show(skeleton(0)) == []


def test_markers_are_sized_by_mass_and_never_zero() -> None:
    made = skeleton(3)
    heavy = Skeleton(
        made.nodes, made.edges, np.array([0.0, 8 / 9, 1 / 9]), made.radius, made.node_ids
    )
    _, middle, light, lines = skeleton_markers(heavy)
    assert middle.scale[0] == pytest.approx(2 * light.scale[0])
    assert all(m.scale[0] > 0 for m in skeleton_markers(heavy))
    assert lines.points.shape == (4, 3)
    point = Skeleton(np.zeros((1, 3)), np.empty((0, 2), int), [1.0], [0.0], [5])  # type: ignore[arg-type]
    assert [m.scale[0] > 0 for m in skeleton_markers(point)] == [True]


# --- mdcs run


def mdcs(*args: object) -> Any:
    return CliRunner().invoke(app, [str(arg) for arg in args])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    points = demo_cloud(1000).astype(np.float32)
    with Recorder(tmp_path_factory.mktemp("bag"), "mcap") as bag:
        for k in range(2):
            bag.cloud(BASE + k * SECOND, points + np.float32(k))
        bag.cloud(BASE, points, topic="/other")
    return bag.path


def test_run_on_a_bag_is_a_sequence(recorded: Path, tmp_path: Path) -> None:
    done = mdcs("run", "paper", "-i", recorded, "--topic", "/lidar", "-o", tmp_path / "out")
    assert done.exit_code == 0, done.stderr
    files = sorted((tmp_path / "out").iterdir())
    assert [p.name for p in files] == ["000000.json", "000001.json"]
    first, second = map(Skeleton.load, files)
    assert (second.header.stamp_ns, second.header.frame_id) == (BASE + SECOND, "lidar")
    np.testing.assert_allclose(second.nodes, first.nodes + 1, atol=1e-4)


def test_run_on_one_cloud_of_a_bag(recorded: Path, tmp_path: Path) -> None:
    """One cloud comes out as one file, and with the time and frame that were asked for."""
    out = tmp_path / "s.json"
    words = ("run", "paper", "-i", recorded, "--topic", "/lidar", "--frame", 1, "-o", out)
    assert mdcs(*words).exit_code == 0
    assert Skeleton.load(out).header == Header("lidar", BASE + SECOND)
    assert mdcs(*words, "--frame-id", "base", "--stamp-ns", 5).exit_code == 0
    assert Skeleton.load(out).header == Header("base", 5)


def test_run_into_a_bag(recorded: Path, tmp_path: Path) -> None:
    """All frames in one file: clouds as they came and skeletons, at their times."""
    out = tmp_path / "out.mcap"
    done = mdcs("run", "paper", "-i", recorded, "--topic", "/lidar", "-o", out, "--json")
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["frames"][1]["outputs"] == [str(out)]
    assert {t.name: t.messages for t in bag_topics(out)} == {"/points": 2, "/skeleton": 2}
    assert [f.stamp_ns for f in BagFrames(out)] == [BASE, BASE + SECOND]


def test_files_without_time_follow_one_another_in_a_bag(tmp_path: Path) -> None:
    """Stamps of 0 stay, but in the bag the frames do not stand on one another."""
    frames = tmp_path / "frames"
    frames.mkdir()
    for k in range(2):
        np.save(frames / f"{k}.npy", demo_cloud(800))
    assert mdcs("run", "paper", "-i", frames, "-o", tmp_path / "out.mcap").exit_code == 0
    with AnyReader([tmp_path / "out.mcap"]) as reader:
        times = sorted({when for _, when, _ in reader.messages()})
    assert times == [0, SECOND // 10]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ((), "2 topics of PointCloud2"),
        (("--topic", "/none"), "no topic '/none'"),
        (("--topic", "/lidar", "--frame", "2"), "counts from 0 to 1"),
        (("--topic", "/lidar", "--frame", "-1"), "no cloud of number -1"),
    ],
)
def test_run_refuses_in_words(recorded: Path, words: tuple[str, ...], text: str) -> None:
    done = mdcs("run", "paper", "-i", recorded, *words)
    assert done.exit_code == 2
    assert text in done.stderr
    assert "Traceback" not in done.stderr


def test_run_never_writes_over_its_input(recorded: Path, tmp_path: Path) -> None:
    (inside,) = recorded.glob("*.mcap")
    alone = Path(shutil.copy(inside, tmp_path / "alone.mcap"))
    done = mdcs("run", "paper", "-i", alone, "--topic", "/lidar", "-o", alone)
    assert done.exit_code == 2
    assert "overwrite the input" in done.stderr
    assert alone.read_bytes() == inside.read_bytes()


def test_topic_and_frame_want_a_bag(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", demo_cloud(800))
    done = mdcs("run", "paper", "-i", tmp_path / "a.npy", "--topic", "/lidar")
    assert done.exit_code == 2
    assert "for bags" in done.stderr


def test_without_rosbags_the_extra_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"x")
    code = (
        "import sys; sys.modules['rosbags'] = None; sys.modules['rosbags.highlevel'] = None;"
        "sys.modules['rosbags.typesys'] = None; from mdcs_pipeline.cli import main;"
        f"main(['run', 'paper', '-i', {str(tmp_path / 'a.mcap')!r}])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 2
    assert "mdcs-pipeline[bags]" in done.stderr
