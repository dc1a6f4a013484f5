"""``mdcs view`` and ``--view`` within this process, over a server without sockets."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_viser import closed_at_once, shown
from typer.testing import CliRunner

from mdcs_pipeline.cli.app import app
from mdcs_pipeline.demo import demo_cloud
from mdcs_pipeline.skeleton import Skeleton
from mdcs_pipeline.viewer.page import LivePage


def mdcs(*args: object) -> Any:
    return CliRunner().invoke(app, [str(arg) for arg in args])


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    path = tmp_path / "cloud.npy"
    np.save(path, demo_cloud(1000))
    return path


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> list[LivePage]:
    return closed_at_once(monkeypatch)


def test_a_cloud_is_run_and_shown_and_can_be_made_again(cloud: Path, seen: list[LivePage]) -> None:
    done = mdcs("view", cloud, "--set", "transport.epsilon=3.0")
    assert done.exit_code == 0, done.stderr
    assert "page: http://127.0.0.1:4711" in done.stderr
    assert done.stderr.splitlines()[-1] == "page closed"
    (frame,) = shown(seen[0])
    assert frame.label == "cloud.npy"
    assert frame.settings["transport"]["epsilon"] == 3.0
    assert f"nodes       {len(frame.skeleton)}" in done.stdout
    assert len(frame.again(9.0).skeleton) < len(frame.skeleton)
    # What makes a frame again holds no cloud: of a long sequence they would fill the memory.
    assert frame.again(9.0).points is None
    # What the dial has at first is what was shown.
    np.testing.assert_array_equal(frame.again(3.0).skeleton.nodes, frame.skeleton.nodes)
    assert seen[0]._server.stopped


def test_a_run_shows_every_frame_and_writes_as_ever(
    cloud: Path, tmp_path: Path, seen: list[LivePage]
) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    for number in range(2):
        np.save(frames / f"{number}.npy", demo_cloud(800, seed=number))
    out = tmp_path / "out"
    done = mdcs("run", "-i", frames, "-o", out, "--view", "--json", "-q")
    assert done.exit_code == 0, done.stderr
    assert done.stderr == ""
    assert len(json.loads(done.stdout)["frames"]) == 2
    held = shown(seen[0])
    assert [frame.label for frame in held] == ["0.npy", "1.npy"]
    for frame in held:
        saved = Skeleton.load(out / f"{Path(frame.label).stem}.json")
        np.testing.assert_array_equal(saved.nodes, frame.skeleton.nodes)
    # With both on the page its user may look at what was written.
    del seen[:]
    done = mdcs("view", frames, out)
    assert done.exit_code == 0, done.stderr
    assert [frame.label for frame in shown(seen[0])] == ["0.json", "1.json"]
    assert all(frame.points is not None for frame in shown(seen[0]))


def test_nothing_given_shows_the_demo(seen: list[LivePage]) -> None:
    done = mdcs("view")
    assert done.exit_code == 0, done.stderr
    assert "nothing given" in done.stderr
    assert shown(seen[0])[0].skeleton.summary()["leaves"] == 6


@pytest.mark.parametrize(("host", "open_to_all"), [("0.0.0.0", True), ("127.0.0.1", False)])
def test_who_opens_the_page_to_others_is_warned(
    host: str, open_to_all: bool, cloud: Path, seen: list[LivePage]
) -> None:
    done = mdcs("view", cloud, "--host", host)
    assert done.exit_code == 0, done.stderr
    assert ("without a password" in done.stderr) is open_to_all


def test_a_stage_at_work_is_named_on_the_page(
    cloud: Path, seen: list[LivePage], monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    monkeypatch.setattr(LivePage, "say", lambda page, text, hurry=False: said.append(text))
    assert mdcs("view", cloud, "-q").exit_code == 0
    assert "downsample, round 1 …" in said
    assert "smooth, round 1 …" in said


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["clod.npy"], ["no such file or folder", "did you mean 'cloud.npy'"]),
        (["cloud.npy", "cloud.npy"], ["more than one cloud"]),
        (["cloud.npy", "--port", "70000"], ["--port"]),
        (["cloud.npy", "-c", "defualt"], ["did you mean 'default'"]),
        (["cloud.npy", "--host", "203.0.113.7"], ["no such address", "127.0.0.1"]),
    ],
)
def test_what_cannot_be_shown_is_told(
    words: list[str], told: list[str], cloud: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = importlib.import_module("mdcs_pipeline.viewer.server")
    monkeypatch.setattr(server, "import_viser", lambda: None)
    monkeypatch.chdir(cloud.parent)
    done = mdcs("view", *words)
    assert done.exit_code == 2
    for word in told:
        assert word in done.stderr
    assert "Traceback" not in done.stderr


def test_without_viser_the_extra_is_told_before_the_work(
    cloud: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    done = mdcs("view", cloud)
    assert done.exit_code == 2
    assert "mdcs-pipeline[viewer]" in done.stderr
    assert "round" not in done.stderr
