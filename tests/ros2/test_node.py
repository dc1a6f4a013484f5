"""The node as a user runs it: clouds in, markers and skeletons out, over real DDS."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from peer import (
    BEST_EFFORT,
    ERROR,
    LATCHED,
    OK,
    QUICK,
    STALE,
    WARN,
    Peer,
    active,
    cloud_of,
    cross,
    end,
    limb,
    loaded,
    odometry_of,
    pose_of,
    same,
    stamp,
    start,
)
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2, PointField
from visualization_msgs.msg import Marker

from mdcs_pipeline.pipeline import Pipeline, skeletonize
from mdcs_pipeline.skeleton import Skeleton


def test_a_cloud_gives_the_skeleton_of_the_library(launch: Any, peer: Peer, tmp_path: Path) -> None:
    active(launch)
    points = cross()
    peer.publisher().publish(cloud_of(points, 1_700_000_000_123_456_789, "lidar_front"))
    text = peer.wait(lambda: peer.skeletons and peer.skeletons[-1], "a skeleton")
    skeleton = loaded(text, tmp_path)
    same(skeleton, skeletonize(points))
    assert skeleton.header.frame_id == "lidar_front"
    assert skeleton.header.stamp_ns == 1_700_000_000_123_456_789


def test_markers_show_the_skeleton(launch: Any, peer: Peer) -> None:
    active(launch)
    points = cross()
    peer.publisher().publish(cloud_of(points, 5_000_000_007, "base"))
    markers = peer.wait(lambda: peer.markers and peer.markers[-1].markers, "markers")
    skeleton = skeletonize(points)
    assert {(m.header.frame_id, m.header.stamp.sec, m.header.stamp.nanosec) for m in markers} == {
        ("base", 5, 7)
    }
    assert all(m.action == Marker.ADD and m.pose.orientation.w == 1.0 for m in markers)
    (lines,) = [m for m in markers if m.type == Marker.LINE_LIST]
    ends = np.array([(p.x, p.y, p.z) for p in lines.points])
    np.testing.assert_array_equal(ends, skeleton.nodes[skeleton.edges.ravel()])
    assert lines.scale.x == pytest.approx(0.25 * np.median(skeleton.radius))
    spheres = {m.id: m for m in markers if m.type == Marker.SPHERE}
    assert sorted(spheres) == sorted(skeleton.node_ids)
    for name, node, mass in zip(skeleton.node_ids, skeleton.nodes, skeleton.mass, strict=True):
        place = spheres[name].pose.position
        np.testing.assert_array_equal((place.x, place.y, place.z), node)
        wide = np.median(skeleton.radius) * max(np.cbrt(mass * len(skeleton)), 0.1)
        assert spheres[name].scale.x == pytest.approx(wide)


def test_what_vanishes_is_deleted_and_what_stays_keeps_its_id(launch: Any, peer: Peer) -> None:
    active(launch)
    cloud = peer.publisher()
    cloud.publish(cloud_of(limb(600), 1))
    peer.wait(lambda: len(peer.markers) == 1, "markers")
    cloud.publish(cloud_of(limb(150, length=0.5), 2))
    peer.wait(lambda: len(peer.markers) == 2, "markers again")
    before, after = (array.markers for array in peer.markers)
    shown = {(m.ns, m.id) for m in before}
    gone = {(m.ns, m.id) for m in after if m.action == Marker.DELETE}
    kept = {(m.ns, m.id) for m in after if m.action == Marker.ADD}
    assert gone and gone == shown - kept
    peer.trigger("reset")
    peer.wait(lambda: len(peer.markers) == 3, "markers after the reset")
    assert {(m.ns, m.id) for m in peer.markers[-1].markers} == kept
    assert {m.action for m in peer.markers[-1].markers} == {Marker.DELETE}


def test_one_who_joins_late_gets_the_latest(launch: Any, peer: Peer) -> None:
    active(launch)
    cloud = peer.publisher()
    for number in (1, 2):
        cloud.publish(cloud_of(cross(), number))
        peer.wait(lambda n=number: len(peer.skeletons) == n, "a skeleton")
    late = Peer()
    try:
        late.wait(lambda: late.skeletons and late.markers, "what was latched")
        assert [json.loads(text)["header"]["stamp_ns"] for text in late.skeletons] == [2]
    finally:
        late.close()


def odd_cloud(points: np.ndarray) -> PointCloud2:
    """Return an organised big-endian cloud of doubles, padded, with NaN in it."""
    count = len(points)
    layout = np.dtype(
        {
            "names": ["intensity", "z", "x", "y"],
            "formats": [">u2", ">f8", ">f8", ">f8"],
            "offsets": [0, 4, 12, 20],
            "itemsize": 32,
        }
    )
    rows = np.zeros((2, count // 2 + 1), layout)
    rows["x"].flat[:count], rows["y"].flat[:count], rows["z"].flat[:count] = points.T
    rows["x"].flat[count:] = np.nan
    message = PointCloud2(height=2, width=count // 2 + 1, is_bigendian=True, point_step=32)
    message.row_step = 32 * message.width + 24
    message.data = b"".join(row.tobytes() + b"\xff" * 24 for row in rows)
    message.fields = [
        PointField(name="intensity", offset=0, datatype=PointField.UINT16, count=1),
        *(
            PointField(name=name, offset=offset, datatype=PointField.FLOAT64, count=1)
            for name, offset in (("z", 4), ("x", 12), ("y", 20))
        ),
    ]
    message.is_dense = True
    return stamp(message, 9, "odd")


def test_any_layout_is_read(launch: Any, peer: Peer, tmp_path: Path) -> None:
    active(launch)
    points = cross().astype(np.float64)
    peer.publisher().publish(odd_cloud(points))
    text = peer.wait(lambda: peer.skeletons and peer.skeletons[-1], "a skeleton")
    skeleton = loaded(text, tmp_path)
    same(skeleton, skeletonize(points))
    assert skeleton.diagnostics["dropped"] == 2


def test_bad_clouds_are_refused_with_a_reason_and_the_next_one_works(
    launch: Any, peer: Peer
) -> None:
    active(launch)
    cloud = peer.publisher()
    cut = cloud_of(cross(), 1)
    cut.data = bytes(cut.data)[:-5]
    blind = cloud_of(np.full((10, 3), np.nan), 2)
    nameless = cloud_of(cross(), 3)
    nameless.fields = nameless.fields[:2]
    reasons = ("fewer bytes than", "NaN or infinity", "no field 'z'")
    for number, (message, reason) in enumerate(
        zip((cut, blind, nameless), reasons, strict=True), start=1
    ):
        cloud.publish(message)
        values = peer.wait_status(
            "pipeline",
            lambda level, _, v, n=number, r=reason: (
                level == ERROR and v["frames failed"] == str(n) and r in v["latest error"]
            ),
            f"a refusal for {reason}",
        )
        assert "remedy" in values["latest error"]
    cloud.publish(cloud_of(cross(), 4))
    peer.wait(lambda: peer.skeletons, "a skeleton after the bad clouds")
    values = peer.wait_status("pipeline", lambda level, *_: level == OK, "recovery")
    assert (values["frames done"], values["frames failed"]) == ("1", "3")
    assert float(values["lag (s)"]) > 0 and float(values["time of a frame (s)"]) > 0


def test_lifecycle(launch: Any, peer: Peer) -> None:
    launch("default", "--ros-args", *QUICK)
    assert peer.state() == "unconfigured"
    assert not peer.change_state("activate")
    assert peer.change_state("configure") and peer.state() == "inactive"
    cloud = peer.publisher()
    cloud.publish(cloud_of(cross(), 1))
    peer.wait_status("input", lambda _, __, v: v["clouds"] == "1", "the cloud to arrive")
    assert not peer.skeletons
    assert peer.change_state("activate") and peer.state() == "active"
    cloud.publish(cloud_of(cross(), 2))
    peer.wait(lambda: len(peer.skeletons) == 1, "a skeleton")
    assert peer.change_state("deactivate") and peer.state() == "inactive"
    cloud.publish(cloud_of(cross(), 3))
    peer.wait_status("input", lambda _, __, v: v["clouds"] == "3", "the third cloud")
    assert peer.change_state("activate")
    cloud.publish(cloud_of(cross(), 4))
    peer.wait(lambda: len(peer.skeletons) == 2, "a skeleton after the second activation")
    stamps = [json.loads(text)["header"]["stamp_ns"] for text in peer.skeletons]
    assert stamps == [2, 4]
    assert peer.change_state("deactivate", "cleanup") and peer.state() == "unconfigured"
    peer.wait(lambda: cloud.get_subscription_count() == 0, "the subscription to end")
    last = peer.wait(lambda: len(peer.markers) == 3 and peer.markers[-1], "a last array")
    assert {m.action for m in last.markers} == {Marker.DELETE}
    assert peer.change_state("configure", "activate") and peer.state() == "active"


def test_reset_and_save(launch: Any, peer: Peer, tmp_path: Path) -> None:
    active(launch, "-p", "save_name:=s-{stamp}.json")
    answer = peer.trigger("save")
    assert not answer.success and "no skeleton yet" in answer.message
    peer.publisher().publish(cloud_of(cross(), 77))
    peer.wait(lambda: peer.skeletons, "a skeleton")
    answer = peer.trigger("save")
    assert answer.success and answer.message == str(tmp_path / "s-77.json")
    same(Skeleton.load(tmp_path / "s-77.json"), skeletonize(cross()))
    peer.trigger("reset")
    values = peer.wait_status("pipeline", lambda _, __, v: v["frames done"] == "0", "a reset")
    assert values["frames offered"] == "0"
    assert not peer.trigger("save").success


def test_a_flood_is_thinned_to_the_latest_and_counted(launch: Any, peer: Peer) -> None:
    active(launch, "-p", "qos_depth:=1000")
    profile = LATCHED
    cloud = peer.publisher(qos=profile)
    points = cross(3000)
    total = 60
    for number in range(1, total + 1):
        cloud.publish(cloud_of(points, number))

    def over(_: bytes, __: str, values: dict[str, str]) -> bool:
        used = sum(int(values[f"frames {k}"]) for k in ("done", "failed", "dropped"))
        return values["frames offered"] == str(total) == str(used)

    values = peer.wait_status("pipeline", over, "every cloud to be accounted for")
    assert int(values["frames dropped"]) > 0 and values["frames failed"] == "0"
    done = int(values["frames done"])
    peer.wait(lambda: len(peer.skeletons) == done, "every skeleton")
    stamps = [json.loads(text)["header"]["stamp_ns"] for text in peer.skeletons]
    assert stamps == sorted(stamps) and stamps[-1] == total


PUBLISHER = Path(__file__).with_name("publisher.py")


def publishing() -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, str(PUBLISHER)], text=True)


def test_a_publisher_that_dies_and_returns(launch: Any, peer: Peer) -> None:
    active(launch, "-p", "stale_after:=0.5")
    peer.wait_status(
        "input", lambda level, text, _: level == WARN and "nobody publishes" in text, "silence"
    )
    first = publishing()
    try:
        peer.wait(lambda: len(peer.skeletons) >= 2, "skeletons of the first")
        peer.wait_status("input", lambda level, *_: level == OK, "clouds")
        for part in ("input", "pipeline"):
            peer.wait_status(part, lambda _, __, v: float(v["rate (Hz)"]) > 0, "a rate")
    finally:
        first.kill()
        first.wait()
    peer.wait_status("input", lambda level, *_: level == STALE, "the silence to be told")
    for part in ("input", "pipeline"):
        peer.wait_status(part, lambda _, __, v: float(v["rate (Hz)"]) == 0, "no rate")
    before = len(peer.skeletons)
    second = publishing()
    try:
        peer.wait(lambda: len(peer.skeletons) >= before + 2, "skeletons of the second")
        peer.wait_status("input", lambda level, *_: level == OK, "clouds again")
    finally:
        end(second)
    assert peer.state() == "active"


def test_a_best_effort_publisher_is_heard_too(launch: Any, peer: Peer) -> None:
    active(launch)
    sensor = peer.node.create_publisher(PointCloud2, "cloud", BEST_EFFORT)
    peer.wait(lambda: sensor.get_subscription_count() > 0, "the node to ask for less")
    # What is sent without a promise may be lost.
    number = 0

    def heard() -> bool:
        nonlocal number
        number += 1
        sensor.publish(cloud_of(cross(), number))
        return bool(peer.skeletons)

    peer.wait(heard, "a skeleton")


def test_what_was_latched_before_it_came_is_heard_if_asked_for(launch: Any, peer: Peer) -> None:
    sensor = peer.node.create_publisher(PointCloud2, "cloud", LATCHED)
    sensor.publish(cloud_of(cross(), 3))
    active(launch, "-p", "qos_durability:=transient_local", "-p", "qos_reliability:=reliable")
    peer.wait(lambda: peer.skeletons, "a skeleton of what was latched")
    (asked,) = peer.node.get_subscriptions_info_by_topic("/cloud")
    assert asked.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert asked.qos_profile.reliability == ReliabilityPolicy.RELIABLE


def test_best_effort_is_asked_for_if_set(launch: Any, peer: Peer) -> None:
    active(launch, "-p", "qos_reliability:=best_effort")
    (asked,) = peer.wait(
        lambda: peer.node.get_subscriptions_info_by_topic("/cloud"), "the subscription"
    )
    assert asked.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert asked.qos_profile.durability == DurabilityPolicy.VOLATILE
    sensor = peer.publisher()
    numbers = iter(range(1, 1_000_000))

    def heard() -> bool:
        # What is sent without a promise may be lost.
        sensor.publish(cloud_of(cross(), next(numbers)))
        return bool(peer.skeletons)

    peer.wait(heard, "a skeleton")


TURN = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))


@pytest.mark.parametrize(
    ("kind", "message", "make"),
    [("pose_stamped", PoseStamped, pose_of), ("odometry", Odometry, odometry_of)],
)
def test_poses_lead_clouds_into_their_frame(
    launch: Any, peer: Peer, tmp_path: Path, kind: str, message: Any, make: Any
) -> None:
    """A quarter turn about z, half way between two poses one apart in x."""
    active(launch, "-p", f"pose_type:={kind}", "-p", "pose_tolerance:=0.5")
    poses, cloud = peer.publisher(message, "pose"), peer.publisher()
    poses.publish(make(1_000_000_000, (1, 2, 3), TURN))
    poses.publish(make(1_200_000_000, (2, 2, 3), TURN))
    peer.wait_status("input", lambda _, __, v: v["poses"] == "2", "the poses")
    points = cross()
    cloud.publish(cloud_of(points, 1_100_000_000, "lidar"))
    text = peer.wait(lambda: peer.skeletons and peer.skeletons[-1], "a skeleton")
    skeleton = loaded(text, tmp_path)
    assert (skeleton.header.frame_id, skeleton.header.stamp_ns) == ("odom", 1_100_000_000)
    turned = np.c_[-points[:, 1], points[:, 0], points[:, 2]] + [1.5, 2, 3]
    expected = skeletonize(turned)
    assert len(skeleton) == len(expected)
    np.testing.assert_allclose(skeleton.nodes, expected.nodes, atol=1e-6)


def test_a_cloud_without_a_pose_is_refused(launch: Any, peer: Peer) -> None:
    active(launch, "-p", "pose_type:=odometry", "-p", "pose_wait:=0.05")
    poses, cloud = peer.publisher(Odometry, "pose"), peer.publisher()
    poses.publish(odometry_of(1_000_000_000, (0, 0, 0), (0, 0, 0, 0)))
    peer.wait_status("input", lambda _, __, v: v["bad poses"] == "1", "the bad pose")
    cloud.publish(cloud_of(cross(), 1_000_000_000))
    peer.wait_status(
        "pipeline", lambda _, __, v: "no pose is near" in v["latest error"], "the refusal"
    )
    assert not peer.skeletons


TWO = """
name: two
sources: {left: {}, right: {}}
stages:
  combine: {inputs: {clouds: [sources.left, sources.right]}}
  downsample: {inputs: {cloud: combine.cloud}}
  density: {inputs: {cloud: downsample.cloud}}
  seed: {inputs: {cloud: density.cloud}}
  transport: {inputs: {cloud: density.cloud, nodes: seed.nodes}, settings: {epsilon: 0.01}}
  merge: {inputs: {plan: transport.plan}}
  link: {inputs: {cloud: density.cloud, plan: merge.plan}}
  smooth: {inputs: {cloud: density.cloud, rough: link.rough, points: combine.cloud}}
results: {skeleton: smooth.skeleton}
"""


def test_two_sources_are_two_topics(launch: Any, peer: Peer, tmp_path: Path) -> None:
    config = tmp_path / "two.yaml"
    config.write_text(TWO)
    launch(str(config), "--autostart", "--ros-args", *QUICK, "-r", "right:=/rear/points")
    left, right = peer.publisher(topic="left"), peer.publisher(topic="/rear/points")
    first, second = limb(200), cross(200)
    left.publish(cloud_of(limb(50), 1_000_000))
    left.publish(cloud_of(first, 1_000_000_000))
    right.publish(cloud_of(second, 1_010_000_000))
    text = peer.wait(lambda: peer.skeletons and peer.skeletons[-1], "a skeleton")
    skeleton = loaded(text, tmp_path)
    with Pipeline.from_config(config) as pipeline:
        same(skeleton, pipeline.push({"left": first, "right": second}))
    values = peer.wait_status("input", lambda _, __, v: v["clouds"] == "3", "the counts")
    assert values["unmatched"] == "1"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_cleanly(peer: Peer, tmp_path: Path, number: int) -> None:
    process = start("default", "--autostart", cwd=tmp_path)
    try:
        peer.wait(lambda: peer.state() == "active", "the node")
    finally:
        said = end(process, [number])
    assert process.returncode == 0, said
    assert "Traceback" not in said


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["no-such"], "unknown configuration 'no-such'"),
        (["default", "--ros-args", "-p", "transport.epsilon:=-1.0"], "setting 'epsilon'"),
        (["default", "--ros-args", "-p", "transport.epsilonn:=1.0"], "did you mean"),
        (["default", "--ros-args", "-p", "qos_depht:=3"], "did you mean 'qos_depth'"),
        (["default", "--ros-args", "-p", "save_name:=../x.json"], "without a folder"),
    ],
)
def test_wrong_starts_say_why(tmp_path: Path, arguments: list[str], told: str) -> None:
    process = start(*arguments, cwd=tmp_path)
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 2, said
    assert told in said and "Traceback" not in said
