"""Must be shown, 2 to 4: a scene that grows, a window that slides, a sensor that does not wait."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from benchmarks.stream.run import (
    Cold,
    Timed,
    cold,
    errors,
    quarters,
    resident,
    streamed,
    surface,
)
from benchmarks.stream.scenes import WALK_VOXEL, dancing, network, orbit_views, walk_views
from benchmarks.topology.solid import Floats

#: Frames that the scene holds when a frame of it is compared with a cold run.
MOMENTS = (25, 50, 100, 200)
# Frames before and behind such a moment that stand for it.
_AROUND = 12
# Settings for a sensor that does not wait: less is done at once, so that no frame takes long.
LIVE: dict[str, Any] = {"scene.most": 2500, "scene.share": 0.2}


def grow(frames: int) -> dict[str, Any]:
    """Stream the network as it is revealed; cold runs on the same points as it grows."""
    shape = network(frames)
    clouds = list(walk_views(frames))
    memory: list[int] = []
    colds: dict[int, tuple[int, Cold]] = {}
    for timed in streamed(clouds, WALK_VOXEL):
        memory.append(resident())
        if len(timed.seconds) in MOMENTS:
            points = surface(timed.stream)
            colds[len(timed.seconds)] = len(points), warm_cold(points)
    timed.stream.flush()
    world = timed.stream.scene.world
    assert world is not None
    return {
        "frames": frames,
        "voxels": len(world.voxels),
        "streamed": errors(timed.stream.skeleton(), shape),
        "moments": [moment(timed, held, *found) for held, found in colds.items()],
        "quarters": quarters(timed.seconds),
        "cpu_quarters": quarters(timed.cpu),
        "points_quarters": quarters([float(p) for p in timed.points]),
        "flatness": quarters(timed.seconds)[3] / quarters(timed.seconds)[1],
        "cpu_flatness": quarters(timed.cpu)[3] / quarters(timed.cpu)[1],
        "bytes_per_voxel": bytes_held(timed) / len(world.voxels),
        "memory_growth": memory[frames - 2] - memory[frames // 2],
    }


def warm_cold(points: Floats) -> Cold:
    """Return a cold run at the map's own resolution, once a run before has loaded its kernels."""
    # Fine enough to leave the map's points as they are.
    voxel = 0.25 * WALK_VOXEL
    cold(points, voxel)
    return cold(points, voxel)


def around(count: int, held: int) -> slice:
    """Return which of `count` frames stand for the moment when the scene holds `held`."""
    return slice(max(0, held - _AROUND), min(count, held + _AROUND + 1))


def moment(timed: Timed, held: int, points: int, found: Cold) -> dict[str, Any]:
    """Return what a frame takes beside a cold run, once the scene holds `held` frames."""
    near = around(len(timed.seconds), held)
    seconds, cpu = float(np.median(timed.seconds[near])), float(np.median(timed.cpu[near]))
    return {
        "frames": held,
        "points": points,
        "cold_ms": 1e3 * found.seconds,
        "frame_ms": 1e3 * seconds,
        "cpu_ms": [1e3 * found.cpu, 1e3 * cpu],
        "ratio": found.seconds / seconds,
        "cpu_ratio": found.cpu / cpu,
        "entries": [found.entries, float(np.median(timed.entries[near]))],
        "region": float(np.median(timed.points[near])),
    }


def bytes_held(timed: Timed) -> int:
    """Return what the map's arrays take."""
    world = timed.stream.scene.world
    return 0 if world is None else sum(a.nbytes for a in world.voxels.arrays().values())


def slide(frames: int) -> dict[str, Any]:
    """Stream the network through a window of 20 frames."""
    settings = {"scene.mode": "window", "scene.window_frames": 20}
    memory, voxels = [], []
    for timed in streamed(walk_views(frames), WALK_VOXEL, **settings):
        memory.append(resident())
        voxels.append(len(timed.stream.scene.world.voxels) if timed.stream.scene.world else 0)
    quarter = quarters([float(m) for m in memory])
    return {
        "frames": frames,
        "voxels": [int(v) for v in quarters([float(v) for v in voxels])],
        "memory_mb": [round(m / 1e6, 1) for m in quarter],
        "memory_growth": quarter[3] / quarter[1] - 1.0,
        "flatness": quarters(timed.seconds)[3] / quarters(timed.seconds)[1],
        "cpu_flatness": quarters(timed.cpu)[3] / quarters(timed.cpu)[1],
    }


def replace(frames: int) -> dict[str, Any]:
    """Stream a figure that moves, each frame for itself."""
    right, survived, before = 0, [], set()
    for timed in streamed(dancing(frames), 0.012 * 2.0, **{"scene.mode": "replace"}):
        skeleton = timed.stream.skeleton()
        held = skeleton.summary()
        right += (held["components"], held["cycles"], held["leaves"]) == (1, 0, 5)
        ids = set(skeleton.node_ids.tolist())
        if before:
            survived.append(len(ids & before) / len(before))
        before = ids
    last = cold(surface(timed.stream))
    return {
        "frames": frames,
        "right": right,
        "ids_kept": float(np.mean(survived)),
        "ratio": last.seconds / float(np.mean(timed.seconds[1:])),
    }


def live(seconds: float, rate: float = 10.0) -> dict[str, Any]:
    """Send frames of 30,000 points at a rate, as a sensor would, and see what becomes of them."""
    import threading

    from mdcs_pipeline.overload import Gate, Policy
    from mdcs_pipeline.stream import Stream

    views = orbit_views("quadruped", 100, laps=1.0, points=30_000)
    stream = Stream.from_config(**{"scene.voxel_size": views.voxel, **LIVE})
    gate: Gate[tuple[float, int]] = Gate(Policy("queue", 8))
    count = round(seconds * rate)

    def send() -> None:
        began = time.monotonic()
        for k in range(count):
            time.sleep(max(0.0, began + k / rate - time.monotonic()))
            gate.put((time.monotonic(), k))
        gate.close()

    # A stream that is to keep a rate has its kernels compiled before.
    stream.push(views.clouds[0], stamp_ns=1)
    stream.reset()
    threading.Thread(target=send, daemon=True).start()
    latency, cpu, memory = [], [], []
    for came, k in gate:
        before = time.thread_time()
        stream.push(views.clouds[k % len(views.clouds)], stamp_ns=round((k + 1) * 1e9 / rate))
        cpu.append(time.thread_time() - before)
        latency.append(time.monotonic() - came)
        memory.append(resident())
    half = memory[len(memory) // 2 :]
    return {
        "seconds": seconds,
        "sent": gate.received,
        "dropped": gate.dropped,
        "latency_ms": [1e3 * float(np.quantile(latency, q)) for q in (0.5, 0.99, 1.0)],
        "cpu_ms": [1e3 * float(np.quantile(cpu, q)) for q in (0.5, 0.99, 1.0)],
        "memory_growth": half[-1] / half[0] - 1.0,
    }
