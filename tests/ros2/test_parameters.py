"""Settings as ROS parameters: seen, changed while it runs, refused with a reason."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from peer import Peer, active, cloud_of, cross, loaded, same

from mdcs_pipeline.config import load_spec
from mdcs_pipeline.graph import build_graph
from mdcs_pipeline.pipeline import skeletonize


def test_every_setting_is_a_parameter_with_its_default(launch: Any, peer: Peer) -> None:
    active(launch, "-p", "smooth.smoothing:=0.4")
    names = set(peer.parameter_names())
    graph = build_graph(load_spec("default"))
    for stage, made in graph.stages.items():
        for key, value in made.settings:
            assert f"{stage}.{key}" in names
            (held,) = peer.get(f"{stage}.{key}")
            assert held == (0.4 if (stage, key) == ("smooth", "smoothing") else value)
    assert peer.describe("transport.epsilon").description


def test_a_change_holds_from_the_next_frame_on(launch: Any, peer: Peer, tmp_path: Path) -> None:
    active(launch)
    cloud, points = peer.publisher(), cross(800)
    cloud.publish(cloud_of(points, 1))
    peer.wait(lambda: len(peer.skeletons) == 1, "a skeleton")
    result = peer.set(smooth__smoothing=0.9)
    assert result.successful, result.reason
    # 4 for 4.0 is no reason to refuse.
    assert peer.set(transport__epsilon=4).successful
    cloud.publish(cloud_of(points, 2))
    peer.wait(lambda: len(peer.skeletons) == 2, "a skeleton")
    first, second = (loaded(text, tmp_path) for text in peer.skeletons)
    same(first, skeletonize(points))
    settings = {"smooth.smoothing": 0.9, "transport.epsilon": 4}
    same(second, skeletonize(points, **settings))
    assert len(first) != len(second) or not np.allclose(first.nodes, second.nodes)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"transport.epsilon": -1.0}, "setting 'epsilon'"),
        ({"transport.epsilon": "wide"}, "setting 'epsilon'"),
        ({"transport.power": 3}, "setting 'power'"),
        ({"check.rule": "luck"}, "setting 'rule'"),
        ({"sources.cloud.nonfinite": "maybe"}, "must be one of"),
        ({"config": "paper"}, "fixed while the node runs"),
        ({"save_folder": "/"}, "fixed while the node runs"),
        ({"save_name": "../../etc/x.json"}, "without a folder"),
        ({"save_name": "x.exe"}, "must end in one of"),
        ({"qos_depth": 3}, "clean up the node first"),
        ({"pose_type": "odometry"}, "clean up the node first"),
        ({"node_size": 0.0}, "parameter 'node_size'"),
    ],
)
def test_refusals(shared_node: Peer, change: dict[str, Any], reason: str) -> None:
    ((name, value),) = change.items()
    before = shared_node.get(name)
    result = shared_node.set(**{name.replace(".", "__"): value})
    assert not result.successful
    assert reason in result.reason
    assert shared_node.get(name) == before


def test_unknown_parameters_are_refused(shared_node: Peer) -> None:
    assert not shared_node.set(transport__epsilonn=1.0).successful


def test_changes_together_hold_or_fail_together(shared_node: Peer) -> None:
    before = shared_node.get("transport.epsilon", "smooth.smoothing")
    result = shared_node.set_together({"transport.epsilon": 3.0, "smooth.smoothing": -1.0})
    assert not result.successful and "setting 'smoothing'" in result.reason
    assert shared_node.get("transport.epsilon", "smooth.smoothing") == before
    result = shared_node.set_together({"transport.epsilon": 3.0, "smooth.smoothing": 0.5})
    assert result.successful
    assert shared_node.get("transport.epsilon", "smooth.smoothing") == [3.0, 0.5]


def test_what_is_bound_can_be_changed_before_configuring(launch: Any, peer: Peer) -> None:
    launch("default", "--ros-args", "-p", "diagnostics_period:=0.1")
    assert peer.set(qos_depth=7).successful
    assert peer.change_state("configure")
    result = peer.set(qos_depth=8)
    assert not result.successful and "clean up" in result.reason
    assert peer.change_state("cleanup")
    assert peer.set(qos_depth=8).successful
