"""What the hosts share, without any runtime: the worker, the settings, the poses."""

from __future__ import annotations

import importlib.util
import re
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdcs_pipeline import wire
from mdcs_pipeline.config import load_spec
from mdcs_pipeline.errors import ConfigError, InputError, MissingExtraError
from mdcs_pipeline.nodes import dora, ros2
from mdcs_pipeline.nodes.host import Host, settings_of
from mdcs_pipeline.nodes.latest import Counts, Latest
from mdcs_pipeline.nodes.poses import PoseBuffer, make_pose
from mdcs_pipeline.pipeline import skeletonize
from mdcs_pipeline.poses import posed
from mdcs_pipeline.stream import Stream


class Gate:
    """Work that waits until it is let through."""

    def __init__(self, good: bool = True) -> None:
        self.seen: list[int] = []
        self.begun = threading.Semaphore(0)
        self.let = threading.Semaphore(0)
        self.good = good

    def __call__(self, item: int) -> bool:
        self.seen.append(item)
        self.begun.release()
        assert self.let.acquire(timeout=10)
        return self.good


def test_the_newest_wins_and_the_others_are_counted() -> None:
    gate = Gate()
    worker: Latest[int] = Latest(gate)
    worker.start()
    worker.offer(1)
    gate.begun.acquire()
    for item in (2, 3, 4):
        worker.offer(item)
    gate.let.release(2)
    gate.begun.acquire()
    worker.stop()
    assert gate.seen == [1, 4]
    assert worker.counts == Counts(offered=4, done=2, failed=0, replaced=2)


def test_a_stop_finishes_what_is_at_work_and_drops_what_waits() -> None:
    gate = Gate(good=False)
    worker: Latest[int] = Latest(gate)
    worker.start()
    worker.offer(1)
    gate.begun.acquire()
    worker.offer(2)
    gate.let.release(2)
    worker.stop()
    counts = worker.counts
    assert counts.offered == 2 == counts.done + counts.failed + counts.replaced
    assert counts.failed >= 1
    worker.start()
    worker.offer(3)
    gate.begun.acquire()
    gate.let.release()
    worker.stop()
    assert gate.seen[-1] == 3


@settings(max_examples=20, deadline=None)
@given(st.lists(st.sampled_from(["offer", "stop", "start"]), max_size=30))
def test_counts_always_add_up(actions: list[str]) -> None:
    worker: Latest[int] = Latest(lambda item: item % 3 != 0)
    for number, action in enumerate(actions):
        worker.offer(number) if action == "offer" else getattr(worker, action)()
    worker.start()
    worker.stop()
    counts = worker.counts
    assert counts.offered == actions.count("offer")
    assert counts.offered == counts.done + counts.failed + counts.replaced


def test_settings_have_full_names() -> None:
    held = Host("default").settings()
    assert held["transport.epsilon"] == load_spec("default").stages["transport"].settings["epsilon"]
    assert held["sources.cloud.nonfinite"] == "drop"
    assert held["downsample.voxel_size"] is None


def test_a_change_holds_from_the_next_frame_on(tree: np.ndarray) -> None:
    host = Host("default")
    before = host.push({"cloud": tree}, 5, "map")
    host.change({"smooth.smoothing": 0.9})
    after = host.push({"cloud": tree}, 6, "map")
    np.testing.assert_array_equal(before.nodes, skeletonize(tree).nodes)
    changed = skeletonize(tree, **{"smooth.smoothing": 0.9})
    np.testing.assert_array_equal(after.nodes, changed.nodes)
    assert (after.header.stamp_ns, after.header.frame_id) == (6, "map")
    assert host.settings()["smooth.smoothing"] == 0.9


@pytest.fixture
def tree() -> np.ndarray:
    rng = np.random.default_rng(3)
    along, around = rng.uniform(-1, 1, 400), rng.uniform(0, 2 * np.pi, 400)
    tube = np.c_[along, 0.1 * np.cos(around), 0.1 * np.sin(around)]
    return np.concatenate([tube[:200], tube[200:, [1, 0, 2]]])


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"transport.epsilon": 0}, "setting 'epsilon'"),
        ({"transport.epsilonn": 1}, "did you mean 'transport.epsilon'"),
        ({"nothing": 1}, "has no setting"),
        ({"sources.cloud.nonfinite": "keep"}, "must be one of"),
    ],
)
def test_wrong_changes_change_nothing(changes: dict[str, object], told: str) -> None:
    host = Host("default")
    before = host.settings()
    with pytest.raises(ConfigError, match=told):
        host.change(changes)
    assert host.settings() == before


def test_places_are_fixed_once_the_host_runs(tmp_path: Path) -> None:
    config = tmp_path / "writes.yaml"
    config.write_text(
        "stages:\n  read: {settings: {path: a.ply}}\n"
        "  downsample: {inputs: {cloud: read.cloud}}\nresults: {thin: downsample.cloud}\n"
    )
    host = Host(config)
    host.start_with({"read.path": "b.ply"})
    assert settings_of(host.graph)["read.path"] == "b.ply"
    with pytest.raises(ConfigError, match="names a place on this machine"):
        host.check({"read.path": "/etc/passwd"})


@pytest.mark.parametrize(
    ("position", "quaternion"),
    [((0, 0, 0), (0, 0, 0, 0)), ((0, np.nan, 0), (0, 0, 0, 1)), ((0, 0, 0), (0, 0, 0, np.inf))],
)
def test_what_is_no_pose_is_refused(position: object, quaternion: object) -> None:
    with pytest.raises(InputError, match="no rigid motion"):
        make_pose(0, "odom", position, quaternion)


def quaternion(angle: float) -> np.ndarray:
    return np.array([0, 0, np.sin(angle / 2), np.cos(angle / 2)])


@given(st.floats(-3, 3), st.floats(-1.5, 1.5), st.integers(0, 100))
def test_between_poses_the_turn_is_even(start: float, turn: float, share: int) -> None:
    buffer = PoseBuffer(tolerance_ns=100)
    buffer.add(make_pose(0, "odom", np.zeros(3), quaternion(start)))
    buffer.add(make_pose(100, "odom", np.ones(3), -quaternion(start + turn)))
    found, _ = buffer.wait(share, 0)
    angle = start + turn * share / 100
    expected = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    np.testing.assert_allclose(found[:3, :3], expected, atol=1e-6)
    np.testing.assert_allclose(found[:3, 3], share / 100)


def test_a_pose_turns_and_shifts() -> None:
    buffer = PoseBuffer(tolerance_ns=0)
    buffer.add(make_pose(0, "odom", (1, 2, 3), quaternion(np.pi / 2)))
    pose, frame_id = buffer.wait(0, 0)
    np.testing.assert_allclose(posed(np.array([[1.0, 0, 0]]), pose), [[1, 3, 3]], atol=1e-12)
    assert frame_id == "odom"


def test_the_pose_that_is_on_its_way_is_waited_for() -> None:
    buffer = PoseBuffer(tolerance_ns=50)
    buffer.add(make_pose(100, "odom", (0, 0, 0), (0, 0, 0, 1)))
    late = make_pose(140, "odom", (4, 0, 0), (0, 0, 0, 1))
    timer = threading.Timer(0.05, buffer.add, [late])
    timer.start()
    assert buffer.wait(110, 10)[0][0, 3] == pytest.approx(1)
    timer.join()


def test_a_pose_too_far_in_time_is_none() -> None:
    buffer = PoseBuffer(tolerance_ns=50)
    with pytest.raises(InputError, match="no pose is near"):
        buffer.wait(100, 0)
    buffer.add(make_pose(100, "odom", (7, 0, 0), (0, 0, 0, 1)))
    assert buffer.wait(150, 0)[0][0, 3] == 7
    with pytest.raises(InputError, match="no pose is near"):
        buffer.wait(151, 0)
    buffer.add(make_pose(300, "map", (0, 0, 0), (0, 0, 0, 1)))
    assert buffer.wait(300, 0)[1] == "map"
    with pytest.raises(InputError, match="no pose is near"):
        buffer.wait(100, 0)


@pytest.mark.parametrize(
    ("needs", "main", "arguments"),
    [
        ("rclpy", ros2.main, ["default"]),
        ("dora", dora.main, ["part", "default", "--host", "main"]),
    ],
)
def test_a_runtime_that_is_not_there_is_named(
    needs: str, main: object, arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    if importlib.util.find_spec(needs) is not None:
        pytest.skip(f"{needs} is installed")
    pytest.importorskip("pyarrow")
    assert main(arguments) == 2  # type: ignore[operator]
    said = capsys.readouterr().err
    assert "pip install" in said and needs in said


def test_arrow_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingExtraError, match="ros2"):
        wire.to_bytes(None, "")


def test_a_host_of_a_scene_keeps_it_over_a_change(tree: np.ndarray) -> None:
    host, stream = Host("streaming"), Stream.from_config("streaming")
    for number in (1, 2):
        found = host.push({"cloud": np.add(tree, [number, 0, 0])}, number, "map")
        stream.push(np.add(tree, [number, 0, 0]), stamp_ns=number, frame_id="map")
        np.testing.assert_array_equal(found.nodes, stream.skeleton().nodes)
        host.change({"smooth.smoothing": 0.3})
    assert found.header.stamp_ns == 2
    with pytest.raises(ConfigError, match="after a reset"):
        host.change({"scene.voxel": 0.1})
    with pytest.raises(InputError, match="not used"):
        host.push({"cloud": tree}, 1, "map")
    host.reset()
    host.change({"scene.voxel": 0.08})
    assert len(host.push({"cloud": tree}, 1, "map"))


def test_the_documented_parameters_are_those_of_the_node() -> None:
    from mdcs_pipeline.nodes.ros.settings import OF_CONFIGURED, OF_PROCESS, NodeSettings

    page = (Path(__file__).parent.parent / "docs" / "ros2.md").read_text(encoding="utf-8")
    table = page.partition("| parameter |")[2].partition("\n\n")[0]
    found: dict[str, tuple[str, str]] = {}
    for names, defaults, _, when in re.findall(
        r"^\| (`.*?) \| (.*?) \| (.*?) \| (.*?) \|$", table, re.M
    ):
        pairs = zip(names.split(", "), defaults.split(", "), strict=True)
        found |= {name.strip("`"): (default.strip("`"), when) for name, default in pairs}
    assert sorted(found) == sorted(NodeSettings.model_fields)
    for name, (told, when) in found.items():
        default = NodeSettings.model_fields[name].default
        said = (
            {"true": True, "false": False, "none": ""}.get(told, told)
            if name != "pose_type"
            else told
        )
        assert said == default or float(told) == default
        fixed = "start" if name in OF_PROCESS else "before configuring"
        assert when == (fixed if name in (*OF_PROCESS, *OF_CONFIGURED) else "any time")
