"""dora as a user runs it: its own commands, its own daemons, files in and out."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mdcs_pipeline.skeleton import Skeleton

CONFIGS = Path(__file__).parents[2] / "configs"
SOLVER = {"transport": "solver", "check": "solver"}


def program(name: str) -> str:
    return str(Path(sys.executable).with_name(name))


def cut(folder: Path, hosts: dict[str, str]) -> Path:
    """Write the default graph with some stages on other hosts."""
    graph = yaml.safe_load((CONFIGS / "default.yaml").read_text())
    for stage, host in hosts.items():
        graph["stages"][stage]["host"] = host
    path = folder / "cut.yaml"
    path.write_text(yaml.safe_dump(graph, sort_keys=False))
    return path


def cross(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    along, around = rng.uniform(-1, 1, count), rng.uniform(0, 2 * np.pi, count)
    tube = np.c_[along, 0.1 * np.cos(around), 0.1 * np.sin(around)]
    half = count // 2
    return np.concatenate([tube[:half], tube[half:, [1, 0, 2]]])


def clouds(folder: Path, count: int, points: int = 600) -> list[np.ndarray]:
    folder.mkdir()
    made = [cross(points + 40 * seed, seed) for seed in range(count)]
    for number, cloud in enumerate(made):
        np.save(folder / f"{number:03d}.npy", cloud)
    return made


def export(folder: Path, config: Path, *arguments: str) -> Path:
    flow = folder / "flow.yml"
    done = subprocess.run(
        [program("mdcs"), "export", "dora", str(config), "-o", str(flow), *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr
    return flow


def dora(folder: Path, *arguments: str, seconds: float = 240) -> str:
    done = subprocess.run(
        [program("dora"), *arguments], capture_output=True, text=True, cwd=folder, timeout=seconds
    )
    said = done.stdout + done.stderr
    assert done.returncode == 0, said[-5000:]
    return said


def written(folder: Path) -> list[Skeleton]:
    return [Skeleton.load(path) for path in sorted(folder.glob("*.json"))]


def same(found: Skeleton, expected: Skeleton) -> None:
    for name in ("nodes", "edges", "mass", "radius", "node_ids"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert found.diagnostics["rounds"] == expected.diagnostics["rounds"]


def wait(happened: Callable[[], Any], what: str, seconds: float = 120) -> Any:
    end = time.monotonic() + seconds
    while not (found := happened()):
        assert time.monotonic() < end, f"waited {seconds:g} s in vain: {what}"
        time.sleep(0.02)
    return found


def processes(*words: str) -> list[int]:
    """Return the processes whose command line has these arguments side by side."""
    text = "\0".join(words).encode() + b"\0"
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            held = path.read_bytes()
        except OSError:
            continue
        if text in held:
            found.append(int(path.parent.name))
    return found


def parent(process: int) -> int:
    text = Path(f"/proc/{process}/status").read_text()
    return int(next(line for line in text.splitlines() if line.startswith("PPid:"))[5:])


def kill_host(config: Path, host: str) -> int:
    """Kill the process that runs a host, with no chance to say goodbye."""
    (process,) = processes("part", str(config), "--host", host)
    os.kill(process, signal.SIGKILL)
    return process


def free_ports(count: int) -> list[int]:
    held = [socket.socket() for _ in range(count)]
    for made in held:
        made.bind(("127.0.0.1", 0))
    ports = [made.getsockname()[1] for made in held]
    for made in held:
        made.close()
    return ports


class Cluster:
    """A coordinator and two daemons, A and B, that listen on loopback alone."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.port, *ports = free_ports(5)
        listen = dict(zip("AB", ports[:2], strict=True))
        local = dict(zip("AB", ports[2:], strict=True))
        self.logs = []
        self.running = [self._start("coordinator", "--port", str(self.port), "--store", "memory")]
        wait(self._is_up, "the coordinator")
        for name, other in ("AB", "BA"):
            self.running.append(
                self._start(
                    *("daemon", "--machine-id", name, "--coordinator-port", str(self.port)),
                    *("--local-listen-port", str(local[name])),
                    *("--zenoh-listen", f"127.0.0.1:{listen[name]}"),
                    *("--zenoh-connect", f"tcp/127.0.0.1:{listen[other]}"),
                )
            )
        wait(lambda: self._connected() == 2, "both daemons")

    def _start(self, *arguments: str) -> subprocess.Popen[bytes]:
        log = self.folder / f"{len(self.logs)}.log"
        self.logs.append(log)
        with log.open("wb") as stream:
            return subprocess.Popen(
                [program("dora"), *arguments], stdout=stream, stderr=stream, cwd=self.folder
            )

    def _is_up(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    def _connected(self) -> int:
        said = self.logs[0].read_text(errors="replace")
        return sum(f"daemon {name}-" in said for name in "AB")

    @contextmanager
    def started(self, flow: Path) -> Iterator[None]:
        """Start a dataflow and, behind the block, wait until it has ended."""
        attached = subprocess.Popen(
            [
                *(program("dora"), "start", str(flow), "--attach"),
                *("--coordinator-port", str(self.port)),
            ],
            cwd=self.folder,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        try:
            yield
            said, _ = attached.communicate(timeout=200)
        finally:
            attached.kill()
        assert attached.returncode == 0, said[-4000:]

    def close(self) -> None:
        for process in reversed(self.running):
            process.terminate()
            try:
                process.wait(timeout=20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        for log in self.logs:
            print(log.read_text(errors="replace")[-3000:])
