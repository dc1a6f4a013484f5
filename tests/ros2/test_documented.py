"""What README and docs/ros2.md say to type is typed, and gives a skeleton."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml
from peer import Peer, cloud_of, cross

ROOT = Path(__file__).parents[2]
PAGES = ("README.md", "docs/ros2.md")


def blocks(page: str) -> list[str]:
    text = (ROOT / page).read_text()
    return re.findall(r"^```\w*\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)


def starts() -> list[list[list[str]]]:
    """Return the nodes that each block starts, as the arguments of mdcs-ros2."""
    found = []
    for page in PAGES:
        for block in blocks(page):
            typed = [
                line for line in block.splitlines() if re.match(r"(\w+/bin/)?mdcs-ros2 ", line)
            ]
            nodes = [shlex.split(line, comments=True)[1:] for line in typed]
            found += [nodes] if nodes else []
    return found


def write_graph(folder: Path) -> None:
    """Write my.yaml: the default graph with what the page shows of a cut one put over it."""
    (shown,) = (block for block in blocks("docs/ros2.md") if block.startswith("stages:"))
    graph = yaml.safe_load((ROOT / "configs" / "default.yaml").read_text())
    for name, stage in yaml.safe_load(shown)["stages"].items():
        for key, value in stage.items():
            # But for the host, it shows what is there.
            assert key == "host" or graph["stages"][name][key] == value
            graph["stages"][name][key] = value
    (folder / "my.yaml").write_text(yaml.safe_dump(graph, sort_keys=False))


@pytest.mark.parametrize("nodes", starts(), ids=lambda nodes: f"{len(nodes)} nodes")
def test_what_is_typed_gives_a_skeleton(
    launch: Any, tmp_path: Path, nodes: list[list[str]]
) -> None:
    write_graph(tmp_path)
    for words in nodes:
        launch(*words)
    peer = Peer("/mdcs_main" if "--host" in nodes[0] else "/mdcs")
    try:
        renamed = [word.partition(":=")[2] for word in nodes[0] if word.startswith("cloud:=")]
        cloud = peer.publisher(topic=renamed[0] if renamed else "cloud")
        cloud.publish(cloud_of(cross(), 5))
        peer.wait(lambda: peer.skeletons, "a skeleton")
    finally:
        peer.close()


def test_each_block_is_seen() -> None:
    assert [len(nodes) for nodes in starts()] == [1, 1, 2]
