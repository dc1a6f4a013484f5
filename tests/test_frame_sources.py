"""Frames from folders, pose files and pipes; and what happens when they come too fast."""

from __future__ import annotations

import io
import json
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import shapes

from mdcs_pipeline.errors import ConfigError, InputError
from mdcs_pipeline.frames import Frame
from mdcs_pipeline.io.frame_folder import FolderFrames, piped_frames, read_poses
from mdcs_pipeline.overload import Gate, Policy, parse_policy


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for k in (10, 2, 1):
        np.save(tmp_path / f"cloud_{k}.npy", np.full((k, 3), float(k)))
    return tmp_path


def quaternion_line(stamp: str, place: tuple[float, ...], turn: tuple[float, ...]) -> str:
    return " ".join([stamp, *map(str, place), *map(str, turn)])


# --- folders


def test_clouds_come_in_the_order_of_their_numbers(folder: Path) -> None:
    frames = list(FolderFrames(folder, frame_id="map"))
    assert [len(frame.points) for frame in frames] == [1, 2, 10]
    assert [frame.stamp_ns for frame in frames] == [1, 2, 3]
    assert {frame.frame_id for frame in frames} == {"map"}
    assert all(frame.pose is None for frame in frames)


def test_a_rate_gives_stamps(folder: Path) -> None:
    stamps = [frame.stamp_ns for frame in FolderFrames(folder, rate=10.0)]
    assert stamps == [100_000_000, 200_000_000, 300_000_000]


def test_reading_goes_on_from_any_frame(folder: Path) -> None:
    frames = FolderFrames(folder)
    assert [(f.stamp_ns, len(f.points)) for f in frames.since(2)] == [(3, 10)]
    assert len(frames) == 3


def test_poses_beside_the_clouds_are_found(folder: Path) -> None:
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [1, 2, 3]
    np.save(folder / "poses.npy", poses)
    frames = list(FolderFrames(folder))
    assert [len(frame.points) for frame in frames] == [1, 2, 10]
    assert [frame.pose[0, 3] for frame in frames if frame.pose is not None] == [1, 2, 3]


def test_poses_as_rows_of_text(folder: Path) -> None:
    rows = ["# R t", *(f"1 0 0 {k} 0 1 0 0 0 0 1 0" for k in range(3)), ""]
    (folder / "poses.txt").write_text("\n".join(rows))
    poses = [frame.pose for frame in FolderFrames(folder)]
    for k, pose in enumerate(poses):
        expected = np.eye(4)
        expected[0, 3] = k
        np.testing.assert_array_equal(pose, expected)


def test_poses_with_stamps_and_quaternions(tmp_path: Path) -> None:
    path = tmp_path / "track.txt"
    half = np.sqrt(0.5)
    path.write_text(
        quaternion_line("1700000000.123456789", (1, 2, 3), (0, 0, half, half))
        + "\n"
        + quaternion_line("1700000001", (0, 0, 0), (0, 0, 0, 1))
    )
    stamps, poses = read_poses(path)
    assert stamps == [1_700_000_000_123_456_789, 1_700_000_001_000_000_000]
    np.testing.assert_allclose(poses[0, :3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    np.testing.assert_array_equal(poses[0, :3, 3], [1, 2, 3])


@pytest.mark.parametrize("text", ["1 2 3", "a b", "1 0 0 0 0 1 0 0 0 0 1 0\n1 2", ""])
def test_what_is_no_pose_is_refused_with_its_file(tmp_path: Path, text: str) -> None:
    path = tmp_path / "poses.txt"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_poses(path)
    assert str(path) in str(caught.value)


def test_too_few_poses_are_refused(folder: Path) -> None:
    np.save(folder / "poses.npy", np.tile(np.eye(4), (2, 1, 1)))
    with pytest.raises(InputError, match="3 clouds and 2 poses"):
        FolderFrames(folder)


# --- pipes


def test_lines_and_arrays_come_through_a_pipe() -> None:
    stream = io.BytesIO()
    cloud = shapes.y(50)
    line = {"points": [[1, 2, 3]], "stamp_ns": 7, "frame_id": "odom", "pose": np.eye(4).tolist()}
    stream.write(json.dumps(line).encode() + b"\n\n")
    np.save(stream, cloud)
    np.save(stream, cloud.astype(np.float32))
    stream.write(b'{"points": []}')
    stream.seek(0)
    first, second, third, last = piped_frames(stream, "map")
    assert (first.stamp_ns, first.frame_id) == (7, "odom")
    np.testing.assert_array_equal(first.pose, np.eye(4))
    np.testing.assert_array_equal(second.points, cloud)
    assert (second.stamp_ns, second.frame_id) == (2, "map")
    assert third.points.dtype == np.float32
    assert last.points.shape == (0, 3)


@pytest.mark.parametrize(
    "data",
    [b"[1, 2]\n", b"{}\n", b"{broken\n", b"\x93NUMPY\x01\x00", b'{"points": [[1, 2]]}\n', b"xyz\n"],
)
def test_what_is_no_frame_is_refused_with_its_number(data: bytes) -> None:
    with pytest.raises(InputError, match="no frame") as caught:
        list(piped_frames(io.BytesIO(b'{"points": []}\n' + data)))
    assert caught.value.where == "frame 2"


def test_a_pickle_is_never_loaded() -> None:
    stream = io.BytesIO()
    np.save(stream, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    stream.seek(0)
    with pytest.raises(InputError, match="no frame"):
        list(piped_frames(stream))


# --- overload


@pytest.mark.parametrize(
    ("text", "policy"),
    [
        ("block", Policy("block")),
        ("latest", Policy("latest")),
        ("queue:7", Policy("queue", 7)),
    ],
)
def test_policies_by_name(text: str, policy: Policy) -> None:
    assert parse_policy(text) == policy


@pytest.mark.parametrize("text", ["", "queue", "queue:0", "queue:x", "latest:2", "drop"])
def test_unknown_policies_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="policy"):
        parse_policy(text)


@pytest.mark.parametrize(
    ("policy", "left"), [(Policy("latest"), [9]), (Policy("queue", 3), [7, 8, 9])]
)
def test_what_waits_and_what_goes(policy: Policy, left: list[int]) -> None:
    gate: Gate[int] = Gate(policy)
    for k in range(10):
        assert gate.put(k)
    gate.close()
    assert list(gate) == left
    assert (gate.received, gate.dropped) == (10, 10 - len(left))


@pytest.mark.parametrize("policy", [Policy("block"), Policy("latest"), Policy("queue", 4)])
def test_counts_add_up_between_threads(policy: Policy) -> None:
    gate: Gate[int] = Gate(policy)

    def bring() -> None:
        for k in range(300):
            gate.put(k)
        gate.close()

    thread = threading.Thread(target=bring)
    thread.start()
    taken = []
    for value in gate:
        taken.append(value)
        if len(taken) % 50 == 0:
            time.sleep(0.002)
    thread.join()
    assert gate.received == 300
    assert len(taken) + gate.dropped == 300
    assert taken == sorted(set(taken))
    assert taken[-1] == 299
    if policy.kind == "block":
        assert not gate.dropped


def test_a_fault_of_the_source_comes_after_what_it_brought() -> None:
    gate: Gate[int] = Gate(Policy("queue", 5))
    gate.put(1)
    gate.close(InputError("broken"))
    taken = iter(gate)
    assert next(taken) == 1
    with pytest.raises(InputError, match="broken"):
        next(taken)


def test_a_source_that_waits_is_let_go_when_nobody_takes() -> None:
    gate: Gate[int] = Gate(Policy("block"))
    gate.put(1)
    answers: list[bool] = []
    thread = threading.Thread(target=lambda: answers.append(gate.put(2)))
    thread.start()
    gate.close()
    thread.join(timeout=10)
    assert answers == [False]
    assert (gate.received, gate.dropped) == (1, 0)


def test_frames_are_what_readers_yield() -> None:
    frame = Frame(1, "map", shapes.y(10))
    assert frame.pose is None
