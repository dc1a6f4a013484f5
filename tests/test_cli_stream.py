"""``mdcs stream`` as a process: outputs, counts, scenes, and being killed at any moment."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import frames
import numpy as np
import pytest

COMMAND = [sys.executable, "-m", "mdcs_pipeline", "stream", "streaming"]
SET = ["--set", f"scene.voxel_size={frames.VOXEL}"]


def mdcs(*arguments: str | Path, stdin: bytes | None = None) -> subprocess.CompletedProcess[bytes]:
    words = [*COMMAND, *SET, *map(str, arguments)]
    return subprocess.run(words, capture_output=True, input=stdin, timeout=240, check=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("frames")
    for k, cloud in enumerate(frames.orbit(10)):
        np.save(made / f"frame_{k}.npy", cloud)
    return made


@pytest.fixture(scope="module")
def whole(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole")
    # A process that compiles kernels ends 1e-10 apart from those that find them in the cache:
    # equal to the last bit are runs of the same compiled code, so that is made first.
    assert mdcs("-i", folder, "-q").returncode == 0
    done = mdcs("-i", folder, "-o", out / "y.json", "-o", out / "y.jsonl", "-q")
    assert done.returncode == 0, done.stderr
    return out


def content(path: Path) -> dict[str, Any]:
    held: dict[str, Any] = json.loads(path.read_text())
    return held


def test_a_folder_gives_lines_and_a_skeleton(folder: Path, whole: Path) -> None:
    lines = [json.loads(line) for line in (whole / "y.jsonl").read_text().splitlines()]
    assert len(lines) >= 10
    assert [line["stamp_ns"] for line in lines[:10]] == list(range(1, 11))
    held: dict[str, list[float]] = {}
    for line in lines:
        for name in line["removed"]:
            del held[str(name)]
        held.update(line["added"])
        held.update(line["moved"])
    skeleton = content(whole / "y.json")
    expected = dict(zip(map(str, skeleton["node_ids"]), skeleton["nodes"], strict=True))
    assert held == expected


def test_progress_and_summary(folder: Path, tmp_path: Path) -> None:
    done = mdcs("-i", folder, "-o", tmp_path / "y.ply")
    assert done.returncode == 0
    err, out = done.stderr.decode(), done.stdout.decode()
    assert err.count("lag") == 10
    for word in ("frame 9", "nodes", "ms", "splice"):
        assert word in err
    assert "10 frames: 10 used, 0 dropped" in out
    assert "1 pieces, 0 loops, 3 ends" in out


def test_json_counts_add_up_under_overload(folder: Path) -> None:
    done = mdcs("-i", folder, "--overload", "latest", "--json")
    held = json.loads(done.stdout)
    assert done.returncode == 0
    counts = held["frames"]
    assert counts["received"] == 10 == counts["used"] + counts["dropped"]
    assert sum(counts["why"].values()) == counts["dropped"]
    assert counts["why"].get("overload", 0) > 0


def test_a_pipe_of_arrays(folder: Path, whole: Path, tmp_path: Path) -> None:
    data = b"".join((folder / f"frame_{k}.npy").read_bytes() for k in range(10))
    done = mdcs("-i", "-", "-o", tmp_path / "y.json", "-q", stdin=data)
    assert done.returncode == 0, done.stderr
    assert content(tmp_path / "y.json")["nodes"] == content(whole / "y.json")["nodes"]


def test_a_scene_that_a_frame_id_ends_is_written_too(tmp_path: Path) -> None:
    clouds = frames.orbit(4)
    lines = [
        json.dumps({"points": cloud.tolist(), "frame_id": name, "stamp_ns": k + 1})
        for k, (cloud, name) in enumerate(zip(clouds, ["a", "a", "b", "b"], strict=True))
    ]
    out = tmp_path / "y.json"
    done = mdcs("-i", "-", "-o", out, "--json", stdin="\n".join(lines).encode())
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["scenes"] == 2
    assert content(tmp_path / "y.0.json")["header"]["frame_id"] == "a"
    assert content(out)["header"]["frame_id"] == "b"


def test_frames_that_are_none_are_counted_or_end_the_run(tmp_path: Path) -> None:
    cloud = frames.orbit(1)[0]
    bad = [[], [[None, 1.0, 2.0]] * 5]
    given = [cloud.tolist(), *bad, cloud.tolist()]
    stamps = [1, 2, 3, 1]
    data = "\n".join(
        json.dumps({"points": p, "stamp_ns": s}) for p, s in zip(given, stamps, strict=True)
    ).encode()
    done = mdcs("-i", "-", "-o", tmp_path / "y.json", "--json", stdin=data)
    counts = json.loads(done.stdout)["frames"]
    assert (counts["received"], counts["used"], counts["dropped"]) == (4, 1, 3)
    done = mdcs("-i", "-", "--unusable", "refuse", stdin=data)
    assert done.returncode == 2
    assert b"the frame is empty" in done.stderr
    assert b"Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["-i", "nowhere"], "folder of cloud files"),
        (["-i", "-", "-o", "x.docx"], "no format has the suffix"),
        (["-i", "-", "--overload", "some"], "policy"),
        (["-i", "-", "--every", "often", "--checkpoint", "c"], "--every"),
        (["-i", "-", "--set", "scene.mode=window"], "window_frames"),
    ],
)
def test_faults_are_told_in_words(arguments: list[str], what: str) -> None:
    done = mdcs(*arguments, stdin=b"")
    assert done.returncode == 2
    assert what in done.stderr.decode()
    assert b"Traceback" not in done.stderr


def test_a_configuration_without_a_scene_is_refused(folder: Path) -> None:
    words = [sys.executable, "-m", "mdcs_pipeline", "stream", "default", "-i", str(folder)]
    done = subprocess.run(words, capture_output=True, timeout=120, check=False)
    assert done.returncode == 2
    assert b"keeps no scene" in done.stderr


# --- being killed


def killed_and_resumed(folder: Path, out: Path, kills: list[float]) -> Path:
    """Run, kill after each of the given times, and go on until the run ends by itself."""
    words = [
        *COMMAND, *SET, "-i", str(folder), "-o", str(out / "y.json"), "-o", str(out / "y.jsonl"),
        "--checkpoint", str(out / "scene.ckpt"), "--every", "2", "-q",
    ]  # fmt: skip
    for seconds in kills:
        process = subprocess.Popen(words)
        try:
            process.wait(timeout=seconds)
        except subprocess.TimeoutExpired:
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
    subprocess.run(words, check=True, timeout=240)
    return out


def test_killed_runs_resume_and_end_alike(folder: Path, whole: Path, tmp_path: Path) -> None:
    began = time.monotonic()
    subprocess.run([*COMMAND, *SET, "-i", str(folder), "-q"], check=True, timeout=240)
    lasts = time.monotonic() - began
    rng = np.random.default_rng(1)
    for round_ in range(2):
        out = tmp_path / str(round_)
        out.mkdir()
        killed_and_resumed(folder, out, (rng.uniform(0.3, 1.0, 2) * lasts).tolist())
        for name in ("nodes", "edges", "mass", "radius", "node_ids", "header"):
            assert content(out / "y.json")[name] == content(whole / "y.json")[name]
        assert (out / "y.jsonl").read_bytes() == (whole / "y.jsonl").read_bytes()


def test_a_damaged_checkpoint_is_refused_and_left_alone(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "scene.ckpt"
    path.write_bytes(b"MDCSCKPT" + b"nonsense" * 20)
    done = mdcs("-i", folder, "--checkpoint", path)
    assert done.returncode == 2
    assert b"damaged" in done.stderr
    assert path.read_bytes().endswith(b"nonsense")
