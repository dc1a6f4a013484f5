"""``mdcs stream`` on a recording: posed clouds, clouds without a pose, and going on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import frames
import numpy as np
import pytest
from typer.testing import CliRunner

from mdcs_pipeline.cli.app import app
from mdcs_pipeline.skeleton import Skeleton
from mdcs_pipeline.stream import Stream

pytest.importorskip("rosbags")
from test_bags import BASE, QUARTER, SECOND, Recorder

SHIFT = np.array([1.0, 2.0, 3.0])


def as_sensed(points: np.ndarray) -> np.ndarray:
    """Return points of the scene as a sensor at `SHIFT`, a quarter turn about z, sees them."""
    x, y, z = (points - SHIFT).T
    return np.stack([y, -x, z], axis=1).astype(np.float32)


def recorded(folder: Path, kind: str, count: int) -> Path:
    """Return a bag of two clouds from before the first pose, and `count` behind it."""
    folder.mkdir()
    with Recorder(folder, kind) as bag:
        for k in range(2):
            bag.cloud(BASE + k * SECOND, as_sensed(frames.orbit(1)[0]))
        for k, points in enumerate(frames.orbit(4)[:count], 2):
            bag.pose(BASE + k * SECOND, tuple(SHIFT), QUARTER)
            bag.cloud(BASE + k * SECOND, as_sensed(points))
    return bag.path


def streamed(bag: Path, *more: object) -> dict[str, Any]:
    words = ["stream", "streaming", "--set", f"scene.voxel_size={frames.VOXEL}", "-i", bag]
    chosen = ["--topic", "/lidar", "--pose-topic", "/pose", "--json", *more]
    done = CliRunner().invoke(app, [str(word) for word in [*words, *chosen]])
    assert done.exit_code == 0, done.output
    held: dict[str, Any] = json.loads(done.stdout)
    return held


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "ros1"])
def test_posed_clouds_make_the_scene_and_the_others_are_counted(tmp_path: Path, kind: str) -> None:
    out = tmp_path / "s.json"
    held = streamed(recorded(tmp_path / "bag", kind, 4), "-o", out)["frames"]
    assert held == {"received": 6, "used": 4, "dropped": 2, "why": {"no pose": 2}}
    found = Skeleton.load(out)
    # The points are where the poses lead, and the result says so.
    assert found.header.frame_id == "odom"
    assert found.header.stamp_ns == BASE + 5 * SECOND
    stream = Stream.from_config("streaming", **frames.SETTINGS)
    for k, points in enumerate(frames.orbit(4)):
        stream.push(points, stamp_ns=k + 1)
    stream.flush()
    wanted = stream.skeleton()
    away = np.linalg.norm(found.nodes[:, None] - wanted.nodes[None], axis=2)
    assert away.min(axis=0).max() < frames.VOXEL
    assert away.min(axis=1).max() < frames.VOXEL


def test_going_on_takes_no_frame_twice(tmp_path: Path) -> None:
    """Frames were counted behind those without a pose, and looked for by all clouds."""
    half, whole = (recorded(tmp_path / f"{n}", "mcap", n) for n in (2, 4))
    strict = ["--set", "scene.older=refuse", "--unusable", "refuse"]
    words = [*strict, "--checkpoint", tmp_path / "scene.ckpt", "--every", "1"]
    assert streamed(half, *words)["frames"]["used"] == 2
    held = streamed(whole, *words)
    assert held["frames"] == {"received": 6, "used": 4, "dropped": 2, "why": {"no pose": 2}}
