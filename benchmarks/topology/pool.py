"""Worker processes that outlive crashes and time-outs of what they run."""

from __future__ import annotations

import sys
import time
import traceback
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

import numpy as np

from benchmarks.topology.cases import Case
from benchmarks.topology.methods import method
from benchmarks.topology.score import failed, score
from benchmarks.topology.shapes import make
from benchmarks.topology.solid import Floats, sample

Task = tuple[Case, str]
Record = dict[str, Any]


def record(case: Case, name: str, points: int, seconds: float, **more: Any) -> Record:
    """Return one line of the report."""
    return {**asdict(case), "method": name, "points": points, "seconds": round(seconds, 4), **more}


def failure(task: Task, message: str, points: int = 0, seconds: float = 0.0) -> Record:
    """Return the line of a method that gave no skeleton."""
    case, name = task
    outcome = asdict(failed(case.truth()))
    # A method that fails is wrong even where only what it lacks would be counted.
    outcome["errors"] = max(outcome["errors"], 1)
    return record(case, name, points, seconds, failed=True, message=message, **outcome)


@lru_cache(maxsize=8)
def _cloud(case: Case) -> Floats:
    return case.cloud()


def run_task(task: Task) -> Record:
    """Make the case's cloud, run the method on it and score the result."""
    case, name = task
    points = _cloud(case)
    start = time.perf_counter()
    try:
        made = method(name)(points.copy())
        seconds = time.perf_counter() - start if made.seconds is None else made.seconds
        outcome = asdict(score(made.nodes, made.edges, made.radius, case.truth()))
    except Exception as error:
        message = "".join(traceback.format_exception_only(error)).strip()
        return failure(task, message, len(points), time.perf_counter() - start)
    return record(case, name, len(points), seconds, failed=False, message="", **outcome)


def warm_up(name: str) -> None:
    """Run a method once, so that compiling is not counted in the first case's time."""
    points = sample(make("y"), 1000, np.random.default_rng(0)).points
    try:
        method(name)(points)
    except Exception as error:
        print(f"warm-up of {name}: {error}", file=sys.stderr)


def _work(pipe: Connection, names: list[str]) -> None:
    for name in names:
        warm_up(name)
    pipe.send(None)
    while True:
        task = pipe.recv()
        if task is None:
            return
        pipe.send(run_task(task))


@dataclass
class Worker:
    """One process, the task it holds and when it began."""

    names: list[str]
    task: Task | None = None
    since: float = 0.0
    ready: bool = False
    process: BaseProcess = field(init=False)
    pipe: Connection = field(init=False)

    def __post_init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Start the process; it reports once its methods are warm."""
        context = get_context("spawn")
        self.pipe, other = context.Pipe()
        self.process = context.Process(target=_work, args=(other, self.names), daemon=True)
        self.process.start()
        other.close()
        self.task, self.ready, self.since = None, False, time.monotonic()

    def stop(self) -> None:
        """End the process, whatever it does."""
        self.process.kill()
        self.process.join()
        self.pipe.close()

    def give(self, task: Task) -> None:
        """Hand over a task."""
        self.task, self.since = task, time.monotonic()
        self.pipe.send(task)


def run_tasks(tasks: list[Task], names: list[str], jobs: int, timeout: float) -> Iterator[Record]:
    """Run the tasks on `jobs` processes and yield their records as they come.

    A task that runs longer than `timeout` seconds, or ends its process, is a failed case; its
    process is replaced.
    """
    waiting = list(reversed(tasks))
    workers = [Worker(names) for _ in range(max(1, min(jobs, len(tasks))))]
    try:
        while waiting or any(w.task for w in workers):
            for pipe in wait([w.pipe for w in workers], timeout=0.5):
                worker = next(w for w in workers if w.pipe is pipe)
                try:
                    answer = worker.pipe.recv()
                except EOFError:
                    if worker.task is None:
                        raise RuntimeError("a worker ended before its first case") from None
                    answer = failure(worker.task, "the process ended without an answer")
                    worker.stop()
                    worker.start()
                if answer is not None:
                    yield answer
                    worker.task = None
                else:
                    worker.ready = True
            for worker in workers:
                late = time.monotonic() - worker.since > timeout
                if worker.task is not None and late:
                    yield failure(worker.task, f"no answer after {timeout:g} s", 0, timeout)
                    worker.stop()
                    worker.start()
                if worker.ready and worker.task is None and waiting:
                    worker.give(waiting.pop())
    finally:
        for worker in workers:
            worker.stop()
