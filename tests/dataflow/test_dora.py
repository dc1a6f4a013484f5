"""A dataflow as a user runs it: exported, on one daemon and on two, with a stage that dies."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from flows import (
    SOLVER,
    Cluster,
    clouds,
    cross,
    cut,
    dora,
    export,
    kill_host,
    parent,
    processes,
    program,
    same,
    wait,
    written,
)

from mdcs_pipeline.pipeline import Pipeline, skeletonize
from mdcs_pipeline.skeleton import Skeleton


def expected(given: list[np.ndarray]) -> list[Skeleton]:
    with Pipeline.from_config("default") as pipeline:
        return [pipeline.push(points) for points in given]


def check(folder: Path, given: list[np.ndarray]) -> None:
    found = written(folder)
    assert [skeleton.header.seq for skeleton in found] == list(range(len(given)))
    for one, other in zip(found, expected(given), strict=True):
        same(one, other)
    assert any(sum(one.diagnostics["rounds"].values()) > 0 for one in found)


def test_dora_accepts_what_is_exported(tmp_path: Path) -> None:
    clouds(tmp_path / "frames", 1)
    flow = export(tmp_path, cut(tmp_path, SOLVER), "--frames", "frames", "--results", "out")
    assert "wiring OK" in dora(tmp_path, "validate", str(flow))
    drawn = dora(tmp_path, "graph", "--mermaid", str(flow))
    assert "solver" in drawn and "frames" in drawn


def test_hosts_on_one_daemon_give_what_one_process_gives(tmp_path: Path) -> None:
    given = clouds(tmp_path / "frames", 4)
    (tmp_path / "frames" / "0015.npy").write_bytes(b"no cloud")
    hosts = {**SOLVER, "smooth": "last", "bridge": "last"}
    flow = export(tmp_path, cut(tmp_path, hosts), "--frames", "frames", "--results", "out")
    said = dora(tmp_path, "run", str(flow))
    assert "0015.npy" in said
    assert "clouds 4, done 4, failed 0, dropped 0" in said
    check(tmp_path / "out", given)


def test_two_machines_give_what_one_process_gives(tmp_path: Path, cluster: Cluster) -> None:
    given = clouds(tmp_path / "frames", 4)
    machines = {"frames": "A", "main": "A", "results": "A", "solver": "B"}
    placed = [text for k, v in machines.items() for text in ("--machine", f"{k}={v}")]
    files = ("--frames", "frames", "--results", "out")
    config = cut(tmp_path, SOLVER)
    flow = export(tmp_path, config, *files, *placed)
    with cluster.started(flow):
        (solver,) = wait(
            lambda: processes("part", str(config), "--host", "solver"), "the stages of B"
        )
        # Whose child it is tells the machine.
        assert parent(solver) == cluster.running[2].pid
    check(tmp_path / "out", given)


def running(folder: Path, flow: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [program("dora"), "run", str(flow)],
        cwd=folder,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )


def test_a_stage_that_is_killed_in_mid_stream_costs_no_frame(tmp_path: Path) -> None:
    given = clouds(tmp_path / "frames", 12, 1500)
    config, out = cut(tmp_path, SOLVER), tmp_path / "out"
    flow = export(tmp_path, config, "--frames", "frames", "--results", "out")
    process = running(tmp_path, flow)
    try:
        wait(lambda: len(list(out.glob("*.json"))) >= 3, "the first results")
        killed = kill_host(config, "solver")
        wait(
            lambda: set(processes("part", str(config), "--host", "solver")) - {killed},
            "dora to start the stage again",
        )
        assert len(list(out.glob("*.json"))) < 12
        said, _ = process.communicate(timeout=200)
    finally:
        process.kill()
    assert process.returncode == 0, said[-4000:]
    check(out, given)


def test_an_entry_that_is_killed_loses_no_more_than_it_held(tmp_path: Path) -> None:
    clouds(tmp_path / "frames", 12, 1500)
    config, out = cut(tmp_path, SOLVER), tmp_path / "out"
    flow = export(tmp_path, config, "--frames", "frames", "--results", "out")
    process = running(tmp_path, flow)
    try:
        wait(lambda: len(list(out.glob("*.json"))) >= 3, "the first results")
        before = len(list(out.glob("*.json")))
        for path in out.glob("*.json"):
            path.unlink()
        kill_host(config, "main")
        said, _ = process.communicate(timeout=200)
    finally:
        process.kill()
    assert process.returncode == 0, said[-4000:]
    # The frame that was under way goes with it; one may have come out beside the count.
    assert 12 - before - 2 <= len(written(out)) <= 12 - before


TAP = """
import json, sys
import numpy as np, pyarrow as pa
from dora import Node
from mdcs_pipeline import wire
from mdcs_pipeline.messages import MassCloud

for event in Node():
    if event["type"] != "INPUT":
        continue
    value = event["value"]
    cloud = wire.from_arrow(value, MassCloud)
    start = cloud.positions.__array_interface__["data"][0]
    held = [b for b in value.buffers() if b is not None]
    told = {
        "inside": any(b.address <= start < b.address + b.size for b in held),
        "writeable": bool(cloud.positions.flags.writeable),
        "points": len(cloud),
        "schema": wire.describe(cloud),
        "head": event["metadata"]["mdcs"],
    }
    with open(sys.argv[1], "w") as stream:
        json.dump(told, stream)
    break
"""


def added(flow: Path, node: dict[str, Any], script: str) -> None:
    """Put a node of the user's own, a Python script, into a dataflow."""
    path = flow.with_name(f"{node['id']}.py")
    path.write_text(script)
    node["path"] = sys.executable
    node["args"] = f"{path} {node['args']}"
    held = yaml.safe_load(flow.read_text())
    held["nodes"].append(node)
    flow.write_text(yaml.safe_dump(held, sort_keys=False))


def test_messages_are_read_where_they_lie_by_nodes_of_ones_own(tmp_path: Path) -> None:
    (points,) = clouds(tmp_path / "frames", 1, 4000)
    flow = export(tmp_path, cut(tmp_path, SOLVER), "--frames", "frames", "--results", "out")
    told = tmp_path / "told.json"
    tap = {"id": "tap", "args": str(told), "inputs": {"cloud": "main/density.cloud"}}
    added(flow, tap, TAP)
    dora(tmp_path, "run", str(flow))
    found = json.loads(told.read_text())
    assert found["inside"] and not found["writeable"]
    documented = (Path(__file__).parents[2] / "docs" / "wire.md").read_text()
    assert f"### MassCloud\n\n```text\n{found['schema']}\n```" in documented
    assert json.loads(found["head"])["body"]["origin"] == "density"
    assert 0 < found["points"] <= len(points)


CAMERA = """
import sys, time
import numpy as np, pyarrow as pa
from dora import Node

node = Node()
points = np.load(sys.argv[1]).astype(np.float32)
stamp = {"stamp_ns": 1_700_000_000_000_000_005, "frame_id": "camera"}
node.send_output("points", pa.array(points.ravel()), stamp)
node.send_output("points", pa.array(["no", "cloud"]))
# dora drops what nobody has taken when its sender leaves.
time.sleep(8)
"""


def test_clouds_may_come_from_a_node_of_ones_own(tmp_path: Path) -> None:
    points = cross(800, 3)
    np.save(tmp_path / "points.npy", points)
    config = cut(tmp_path, {})
    flow = export(tmp_path, config, "--cloud", "camera/points", "--results", "out")
    camera = {"id": "camera", "args": str(tmp_path / "points.npy"), "outputs": ["points"]}
    added(flow, camera, CAMERA)
    said = dora(tmp_path, "run", str(flow))
    print(said)
    (found,) = written(tmp_path / "out")
    same(found, skeletonize(points.astype(np.float32)))
    assert (found.header.stamp_ns, found.header.frame_id) == (1_700_000_000_000_000_005, "camera")
    assert "the input is no cloud" in said
    assert "clouds 1, done 1, failed 0, dropped 0" in said
