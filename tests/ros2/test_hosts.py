"""A graph cut across processes: stages hosted alone, the same results, hosts that die."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from peer import OK, QUICK, Peer, cloud_of, cross, loaded, same
from std_msgs.msg import UInt8MultiArray

from mdcs_pipeline import wire
from mdcs_pipeline.messages import MassCloud
from mdcs_pipeline.parts.letters import read_head
from mdcs_pipeline.pipeline import Pipeline, skeletonize

CONFIGS = Path(__file__).parents[2] / "configs"

# Both loops of Algorithm 1 are cut.
SOLVER = {"transport": "solver", "check": "solver"}


def cut(folder: Path, hosts: dict[str, str], name: str = "cut.yaml") -> str:
    """Write the default graph with some stages on other hosts."""
    graph = yaml.safe_load((CONFIGS / "default.yaml").read_text())
    for stage, host in hosts.items():
        graph["stages"][stage]["host"] = host
    path = folder / name
    path.write_text(yaml.safe_dump(graph, sort_keys=False))
    return str(path)


@pytest.fixture
def peer() -> Any:
    made = Peer("/mdcs_main")
    yield made
    made.close()


def hosted(launch: Any, config: str, *hosts: str) -> list[Any]:
    return [launch(config, "--host", host, "--autostart", "--ros-args", *QUICK) for host in hosts]


def stamps(peer: Peer) -> list[int]:
    return [json.loads(text)["header"]["stamp_ns"] for text in peer.skeletons]


@pytest.mark.parametrize(
    "hosts",
    [
        SOLVER,
        {"thickness": "one"},
        {"downsample": "front", "clean": "front", "density": "front", "link": "back"},
    ],
    ids=["loops", "one stage", "three processes"],
)
def test_a_cut_graph_gives_what_one_process_gives(
    launch: Any, peer: Peer, tmp_path: Path, hosts: dict[str, str]
) -> None:
    config = cut(tmp_path, hosts)
    hosted(launch, config, "main", *sorted(set(hosts.values())))
    cloud = peer.publisher()
    clouds = [cross(600, seed) for seed in range(3)]
    with Pipeline.from_config("default") as pipeline:
        for number, points in enumerate(clouds, start=1):
            cloud.publish(cloud_of(points, number, "lidar"))
            peer.wait(lambda n=number: len(peer.skeletons) == n, "a skeleton")
            found = loaded(peer.skeletons[-1], tmp_path)
            expected = pipeline.push(points, stamp_ns=number, frame_id="lidar")
            same(found, expected)
            assert found.header == expected.header
            assert found.diagnostics["rounds"] == expected.diagnostics["rounds"]
            assert sum(found.diagnostics["rounds"].values()) > 0


def test_what_travels_is_the_documented_arrow(launch: Any, peer: Peer, tmp_path: Path) -> None:
    hosted(launch, cut(tmp_path, SOLVER), "main", "solver")
    heard: list[Any] = []
    peer.listen(UInt8MultiArray, "/parts/density/cloud", heard.append, 10)
    points = cross()
    peer.publisher().publish(cloud_of(points, 12, "lidar"))
    message = peer.wait(lambda: heard and heard[0], "a letter")
    head, held = wire.from_bytes(message.data)
    assert read_head(head).body == {"origin": "density", "port": "cloud", "version": 1}
    mass = wire.from_arrow(held, MassCloud)
    assert mass.header.frame_id == "lidar" and mass.mass.sum() == pytest.approx(1)


def test_a_host_that_is_missing_is_named_and_the_cloud_waits(
    launch: Any, peer: Peer, tmp_path: Path
) -> None:
    config = cut(tmp_path, SOLVER)
    hosted(launch, config, "main")
    cloud = peer.publisher()
    for number in (1, 2):
        cloud.publish(cloud_of(cross(), number))
    values = peer.wait_status("pipeline", lambda _, __, v: v["frames offered"] == "2", "clouds")
    assert values["waits for"] == "the host 'solver' is not there"
    assert values["frames dropped"] == "1"
    hosted(launch, config, "solver")
    peer.wait(lambda: peer.skeletons, "a skeleton once the host is there")
    assert stamps(peer) == [2]


def test_a_host_that_is_killed_and_started_again_costs_no_frame(
    launch: Any, peer: Peer, tmp_path: Path
) -> None:
    config = cut(tmp_path, SOLVER)
    _, solver = hosted(launch, config, "main", "solver")
    cloud = peer.publisher()
    points = cross(4000)
    cloud.publish(cloud_of(points, 1))
    peer.wait(lambda: len(peer.skeletons) == 1, "a skeleton")
    cloud.publish(cloud_of(points, 2))
    time.sleep(0.1)
    solver.kill()
    solver.wait()
    assert stamps(peer) == [1]
    hosted(launch, config, "solver")
    peer.wait(lambda: len(peer.skeletons) == 2, "the frame that was under way")
    cloud.publish(cloud_of(cross(), 3))
    peer.wait(lambda: len(peer.skeletons) == 3, "the frame after it")
    assert stamps(peer) == [1, 2, 3]
    first, second, _ = (loaded(text, tmp_path) for text in peer.skeletons)
    same(second, first)
    values = peer.wait_status("pipeline", lambda level, *_: level == OK, "recovery")
    assert values["frames failed"] == "0"


def test_a_failure_on_one_host_is_told_where_frames_begin(
    launch: Any, peer: Peer, tmp_path: Path
) -> None:
    config = cut(tmp_path, {"clean": "front", "density": "front"})
    hosted(launch, config, "main", "front")
    cloud = peer.publisher()
    cloud.publish(cloud_of(np.eye(3), 1))
    values = peer.wait_status("pipeline", lambda _, __, v: v["frames failed"] == "1", "failure")
    assert "stage 'density'" in values["latest error"]
    cloud.publish(cloud_of(cross(), 2))
    peer.wait(lambda: peer.skeletons, "the next frame")
    assert stamps(peer) == [2]


def test_a_setting_is_changed_on_the_host_of_its_stage(
    launch: Any, peer: Peer, tmp_path: Path
) -> None:
    hosted(launch, cut(tmp_path, {"smooth": "last"}), "main", "last")
    last = Peer("/mdcs_last")
    try:
        cloud, points = peer.publisher(), cross(600)
        last.wait(lambda: last.state() == "active", "the other host")
        assert last.set(smooth__smoothing=0.9).successful
        cloud.publish(cloud_of(points, 1))
        last.wait(lambda: last.skeletons, "a skeleton")
        same(loaded(last.skeletons[0], tmp_path), skeletonize(points, **{"smooth.smoothing": 0.9}))
    finally:
        last.close()
    assert not peer.skeletons


def test_hosts_with_different_graphs_do_not_work_together(
    launch: Any, peer: Peer, tmp_path: Path
) -> None:
    hosted(launch, cut(tmp_path, SOLVER), "main")
    hosted(launch, cut(tmp_path, {"transport": "solver"}, "other.yaml"), "solver")
    values = peer.wait_status(
        "pipeline", lambda _, __, v: "another graph" in v["latest error"], "the refusal"
    )
    assert values["waits for"] == "the host 'solver' is not there"


def test_a_host_that_no_stage_names_is_refused(launch: Any, tmp_path: Path) -> None:
    process = launch(cut(tmp_path, SOLVER), "--host", "solvr")
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "did you mean 'solver'" in said
