"""A scene in ROS 2: frames add up, settings change, a reset begins anew."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from peer import ERROR, QUICK, Peer, cloud_of, limb, loaded, same

from mdcs_pipeline.stream import Stream


def test_frames_add_up_to_the_scene_of_the_library(launch: Any, peer: Peer, tmp_path: Path) -> None:
    launch("streaming", "--autostart", "--ros-args", *QUICK)
    cloud, stream = peer.publisher(), Stream.from_config("streaming")
    for number in range(1, 5):
        points = np.add(limb(800, number), [0.7 * number, 0, 0])
        cloud.publish(cloud_of(points, number, "map", double=True))
        stream.push(points, stamp_ns=number, frame_id="map")
        peer.wait(lambda n=number: len(peer.skeletons) == n, "a skeleton")
        same(loaded(peer.skeletons[-1], tmp_path), stream.skeleton())
    assert json.loads(peer.skeletons[-1])["header"]["stamp_ns"] == 4
    assert len(loaded(peer.skeletons[-1], tmp_path)) > len(loaded(peer.skeletons[0], tmp_path))


def test_what_a_scene_is_built_on_is_fixed_until_a_reset(launch: Any, peer: Peer) -> None:
    launch("streaming", "--autostart", "--ros-args", *QUICK)
    cloud = peer.publisher()
    assert peer.set(scene__voxel=0.05).successful
    cloud.publish(cloud_of(limb(800), 1, "map"))
    peer.wait(lambda: len(peer.skeletons) == 1, "a skeleton")
    result = peer.set(scene__voxel=0.04)
    assert not result.successful and "after a reset" in result.reason
    assert peer.set(smooth__smoothing=0.5).successful
    cloud.publish(cloud_of(np.add(limb(800), [1, 0, 0]), 2, "map"))
    peer.wait(lambda: len(peer.skeletons) == 2, "the scene to go on")
    first, second = (json.loads(text)["nodes"] for text in peer.skeletons)
    assert len(second) > len(first)
    cloud.publish(cloud_of(limb(800), 1, "map"))
    peer.wait_status("pipeline", lambda level, *_: level == ERROR, "the older frame's refusal")
    peer.trigger("reset")
    assert peer.set(scene__voxel=0.04).successful
    cloud.publish(cloud_of(limb(800), 1, "map"))
    peer.wait(lambda: len(peer.skeletons) == 3, "a new scene")


def test_a_scene_is_not_cut(launch: Any) -> None:
    process = launch("streaming", "--host", "main")
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 2 and "runs in one process" in said
