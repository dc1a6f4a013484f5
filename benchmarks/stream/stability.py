"""Must be shown, 2, 5 and 6: what stays, one pass where nothing changed, and being killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.stream.run import streamed, surface
from benchmarks.stream.scenes import WALK_VOXEL, orbit_views, walk_views
from mdcs_pipeline.kernels.problem import Accuracy, Problem
from mdcs_pipeline.kernels.sinkhorn import solve
from mdcs_pipeline.skeleton import Skeleton

LAPS = ("y", "hand5", "quadruped", "humanoid", "cube", "ladder", "helix", "mug", "chair", "torus")


def second_lap(name: str, frames: int = 20) -> float:
    """Return the share of ids after one lap that are there after another."""
    views = orbit_views(name, 2 * frames, laps=2.0)
    first: set[int] = set()
    for timed in streamed(views.clouds, views.voxel):
        if len(timed.seconds) == frames:
            timed.stream.flush()
            first = set(timed.stream.skeleton().node_ids.tolist())
    last = set(timed.stream.skeleton().node_ids.tolist())
    return len(first & last) / len(first)


def _places(skeleton: Skeleton) -> dict[int, bytes]:
    return {n: p.tobytes() for n, p in zip(skeleton.node_ids.tolist(), skeleton.nodes, strict=True)}


def frozen(frames: int = 40) -> dict[str, Any]:
    """Count nodes that changed without being in the active region, on the growing network."""
    from mdcs_pipeline.stream import Stream

    stream = Stream.from_config(**{"scene.voxel_size": WALK_VOXEL})
    wrong = watched = 0
    before: dict[int, bytes] = {}
    for k, cloud in enumerate(walk_views(frames)):
        change = stream.push(cloud, stamp_ns=k + 1)
        after = _places(stream.skeleton())
        told = {*change.added.tolist(), *change.moved.tolist(), *change.removed.tolist()}
        silent = before.keys() - told
        watched += len(silent)
        wrong += sum(after.get(name) != before[name] for name in silent)
        before = after
    return {"frames": frames, "unnamed": watched, "changed": wrong}


def warm_solve(name: str = "quadruped") -> dict[str, float]:
    """Solve a plan with prescribed masses cold, and again from its potentials."""
    views = orbit_views(name, 12)
    *_, timed = streamed(views.clouds, views.voxel)
    points = surface(timed.stream)
    skeleton = timed.stream.skeleton()
    count, ones = len(points), np.ones(len(points))
    epsilon = (0.03 * views.truth.diagonal) ** 2
    problem = Problem(
        points, ones / count, skeleton.nodes, skeleton.mass, epsilon, ones, np.ones(len(skeleton))
    )
    accuracy = Accuracy(1e-6, 1e-6)
    first = solve(problem, np.zeros(len(skeleton)), accuracy)
    again = solve(problem, first.node_potentials, accuracy)
    gap = float(abs(first.plan - again.plan).sum())
    return {"cold_passes": first.passes, "warm_passes": again.passes, "plan_l1": gap}


def killed(moments: int = 20, seed: int = 0) -> dict[str, int]:
    """Kill `moments` runs of the command at random times, resume each, and compare the ends."""
    rng = np.random.default_rng(seed)
    equal = kills = 0
    with tempfile.TemporaryDirectory() as base:
        folder = Path(base) / "frames"
        folder.mkdir()
        views = orbit_views("y", 16, points=10_000)
        for k, cloud in enumerate(views.clouds):
            np.save(folder / f"{k}.npy", cloud)
        wanted, lasts = _run(folder, Path(base) / "whole", views.voxel, None)
        for k in range(moments):
            out = Path(base) / str(k)
            _, spent = _run(folder, out, views.voxel, float(rng.uniform(0.2, 0.95)) * lasts)
            kills += spent < lasts
            equal += _run(folder, out, views.voxel, None)[0] == wanted
    return {"moments": moments, "killed": kills, "equal": equal}


def _run(folder: Path, out: Path, voxel: float, kill: float | None) -> tuple[bytes, float]:
    out.mkdir(exist_ok=True)
    command = [
        sys.executable, "-m", "mdcs_pipeline", "stream", "streaming", "-i", str(folder),
        "-o", str(out / "s.npz"), "-o", str(out / "s.jsonl"), "-q",
        "--checkpoint", str(out / "scene"), "--every", "3", "--set", f"scene.voxel_size={voxel}",
    ]  # fmt: skip
    began = time.monotonic()
    process = subprocess.Popen(command)
    try:
        process.wait(timeout=kill)
    except subprocess.TimeoutExpired:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        return b"", time.monotonic() - began
    skeleton = Skeleton.load(out / "s.npz")
    arrays = (skeleton.nodes, skeleton.edges, skeleton.mass, skeleton.radius, skeleton.node_ids)
    held = b"".join(array.tobytes() for array in arrays) + (out / "s.jsonl").read_bytes()
    return held, time.monotonic() - began
