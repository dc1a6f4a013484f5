"""README says what is true: its YAML is the shipped file, its Python and its commands run."""

from __future__ import annotations

import re
import shlex
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from fake_viser import closed_at_once
from typer.testing import CliRunner

import mdcs_pipeline as mdcs
from mdcs_pipeline.cli.app import app
from mdcs_pipeline.demo import demo_cloud
from mdcs_pipeline.stage import stage_names

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    found = re.findall(r"^```(\w*)\n(.*?)^```$", README, flags=re.DOTALL | re.MULTILINE)
    return [text for named, text in found if named == language]


def test_the_yaml_is_the_shipped_file() -> None:
    shipped = (ROOT / "configs" / "paper.yaml").read_text(encoding="utf-8")
    assert blocks("yaml") == [shipped.split("\n", 1)[1]]


def test_every_block_of_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    points = demo_cloud(1500)
    space = {"mdcs": mdcs, "points": points, "frames": [(0, points), (1, points)]}
    for block in blocks("python"):
        exec(block, space)
    assert (tmp_path / "wolf.json").exists()
    assert space["skeleton"].header.frame_id == "map"
    assert np.isclose(space["mass"].mass.sum(), 1.0)


def test_the_table_names_every_stage() -> None:
    assert sorted(re.findall(r"^\| `(\w+)` \|", README, flags=re.MULTILINE)) == stage_names()


# --- commands


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the commands are given: a scan, a folder of frames, a bag, and a graph of one's own."""
    pytest.importorskip("rosbags")
    from mdcs_pipeline.io.bag_writer import BagWriter

    made = tmp_path_factory.mktemp("readme")
    # As dense as frames of a scan are: a voxel that a single point hits is no surface yet.
    points = demo_cloud(4000)
    rows = "\n".join(" ".join(map(str, row)) for row in points)
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n"
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    (made / "scan.ply").write_text(f"{head}{axes}end_header\n{rows}\n")
    (made / "frames").mkdir()
    for number in range(2):
        np.save(made / "frames" / f"{number}.npy", points)
    with BagWriter(made / "drive", storage="sqlite3") as bag:
        bag.add_cloud(points, 1, "lidar", topic="/lidar")
        bag.add_cloud(points, 1, "lidar", topic="/rear")
    graph = (ROOT / "configs" / "default.yaml").read_text()
    (made / "my.yaml").write_text(
        graph.replace("  transport:\n", "  transport:\n    host: solver\n")
    )
    return made


def commands() -> list[str]:
    lines = [line for block in blocks("") for line in block.splitlines()]
    return [line.split("  #")[0].split(" # ")[0].strip() for line in lines]


@pytest.mark.parametrize("line", [line for line in commands() if "mdcs " in line])
def test_every_command_runs(line: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("open3d", "matplotlib"):
        pytest.importorskip(module, exc_type=ImportError)
    monkeypatch.chdir(folder)
    pages = closed_at_once(monkeypatch)
    given = b""
    if line.startswith("sensor | "):
        line = line.removeprefix("sensor | ")
        given = b"".join((folder / "frames" / f"{k}.npy").read_bytes() for k in range(2))
    program, *words = shlex.split(line)
    assert program == "mdcs"
    for name in ("skeleton.json", "skeletons"):
        # Each command is tried alone: what others leave behind is there already.
        if name in words and "-o" not in words:
            mdcs.skeletonize(demo_cloud(1500)).save(name)
    done = CliRunner().invoke(app, words, input=given)
    assert done.exit_code == 0, done.output
    assert bool(pages) == (words[0] == "view" or "--view" in words)
    for flag, name in pairwise(words):
        if flag == "-o":
            assert Path(name).exists()


def test_every_other_command_is_one_of_ours() -> None:
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
    project = (ROOT / "pyproject.toml").read_text()
    for line in commands():
        words = line.split()
        if not words or "mdcs " in line:
            continue
        assert words[0] in ("make", "pip", "dora", "mdcs-ros2"), line
        if words[0] == "make":
            assert words[1] in targets
        elif words[0] == "pip":
            (extra,) = re.findall(r"\[([\w-]+)\]", line)
            assert f"\n{extra} = [" in project
