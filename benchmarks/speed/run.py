"""Measure what issue 4 asks for and print it: ``python -m benchmarks.speed [--readme]``.

Times are CPU seconds, medians of `--repeats` runs that take turns, so that a busy machine
slows all alike; every run is a process of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.speed import passes, problems
from benchmarks.speed.table import report, write_readme

RESULTS = Path(__file__).resolve().parents[1] / "results" / "speed.json"
PARTS = ("transport", "skeleton", "growth", "scene", "bandwidth", "start")
Figures = dict[str, Any]
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


def measured(*args: object) -> Figures:
    """Return the figures of one worker process; `missing` where it cannot run."""
    command = [sys.executable, "-m", "benchmarks.speed.worker", *map(str, args)]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env=os.environ | ONE_THREAD
    )
    if done.returncode:
        return {"missing": done.stderr.strip().splitlines()[-1][:200]}
    found: Figures = json.loads(done.stdout.strip().splitlines()[-1])
    print(" ".join(map(str, args)), found, file=sys.stderr, flush=True)
    return found


def median(runs: list[Figures]) -> Figures:
    """Return the median of every figure."""
    if "missing" in runs[0]:
        return runs[0]
    return {key: float(np.median([run[key] for run in runs])) for key in runs[0]}


def in_turn(jobs: dict[str, tuple[object, ...]], repeats: int) -> dict[str, Figures]:
    """Run all jobs, one after another, as often as asked; return medians."""
    runs: dict[str, list[Figures]] = {name: [] for name in jobs}
    for _ in range(repeats):
        for name, args in jobs.items():
            if not (runs[name] and "missing" in runs[name][0]):
                runs[name].append(measured(*args))
    return {name: median(held) for name, held in runs.items()}


def transport(repeats: int) -> Figures:
    """One problem against POT, which gets the passes that plain Sinkhorn needs."""
    needed = passes.plain_passes(problems.transport_problem(), (1e-3,), 20_000)[0]
    jobs: dict[str, tuple[object, ...]] = {
        "ours": ("ours",),
        "ours-tight": ("ours-tight",),
        "pot": ("pot", needed),
        # A pass takes seconds: a few are measured, and as many as are needed reckoned.
        "pot-log": ("pot-log", 3),
    }
    found: Figures = in_turn(jobs, repeats)
    for key in ("cpu", "wall"):
        if key in found["pot-log"]:
            found["pot-log"][key] *= needed / 3
    rows = passes.compare()
    ours, plain = (np.array([getattr(row, who) for row in rows]) for who in ("ours", "plain"))
    found["plain_passes"] = needed
    found["passes"] = {
        "problems": len(rows),
        "failed": sum(not row.converged for row in rows),
        "ours": ours.mean(axis=0).tolist(),
        "plain": plain.mean(axis=0).tolist(),
        "worst_share": (ours / plain).max(axis=0).tolist(),
    }
    found["accuracy"] = passes.accuracy_table(repeats)
    return found


def skeleton(repeats: int) -> Figures:
    """The armadillo's vertices against the peers that are there."""
    jobs: dict[str, tuple[object, ...]] = {
        "mdcs": ("skeleton",),
        "pygel": ("peer", "pygel"),
        "pc-skeletor": ("peer", "pc_skeletor"),
    }
    return in_turn(jobs, repeats)


def growth(repeats: int) -> Figures:
    """The same object with ever more points."""
    return in_turn({f"{n:.0e}": ("skeleton", n) for n in (10**4, 10**5, 10**6, 10**7)}, repeats)


def scene(repeats: int) -> Figures:
    """Copies of one object at its own voxel size, and the exponent of the time."""
    counts = (1, 4, 16, 64)
    found: Figures = in_turn({str(k): ("scene", k) for k in counts}, repeats)
    if all("cpu" in found[str(k)] for k in counts):
        spent = np.log([found[str(k)]["cpu"] for k in counts])
        found["exponent"] = float(np.polyfit(np.log(counts), spent, 1)[0])
    return found


def bandwidth(repeats: int) -> Figures:
    """A Sinkhorn pass against a copy."""
    return in_turn({"pass": ("bandwidth",)}, repeats)


def start(repeats: int) -> Figures:
    """Whole processes of the command line, warm."""
    jobs = {
        "mdcs --help": ["--help"],
        "mdcs run (wolf)": ["run", "default", "-i", str(problems.WOLF), "-q"],
    }
    found: Figures = {}
    for name, args in jobs.items():
        runs = []
        for _ in range(repeats + 1):
            began, before = time.perf_counter(), os.times()
            subprocess.run(
                [sys.executable, "-m", "mdcs_pipeline", *args],
                stdout=subprocess.DEVNULL,
                check=True,
                env=os.environ | ONE_THREAD,
            )
            after = os.times()
            cpu = after.children_user + after.children_system
            cpu -= before.children_user + before.children_system
            runs.append({"wall": time.perf_counter() - began, "cpu": cpu})
        found[name] = median(runs[1:])
    return found


def about() -> dict[str, str]:
    """Return the machine, as far as it says."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    model = next((line.split(":")[1].strip() for line in lines if "model name" in line), "unknown")
    load = " ".join(f"{value:.1f}" for value in os.getloadavg())
    return {
        "processor": f"{model}, {os.cpu_count()} cores",
        "python": platform.python_version(),
        "load at the end": load,
    }


def main(argv: list[str] | None = None) -> int:
    """Run the parts asked for; keep what earlier runs gave of the others."""
    made = argparse.ArgumentParser(prog="python -m benchmarks.speed", description=__doc__)
    made.add_argument("--parts", default=",".join(PARTS), help="comma-separated: %(default)s")
    made.add_argument("--repeats", type=int, default=5, help="runs of each (default 5)")
    made.add_argument("--out", type=Path, default=RESULTS, help="JSON of all figures")
    made.add_argument("--readme", action="store_true", help="write into benchmarks/README.md")
    args = made.parse_args(argv)
    if not problems.ARMADILLO.exists():
        print(f"no data at {problems.DATA}; set MDCS_DATA", file=sys.stderr)
        return 2
    held: Figures = json.loads(args.out.read_text()) if args.out.exists() else {}
    work = {
        "transport": transport,
        "skeleton": skeleton,
        "growth": growth,
        "scene": scene,
        "bandwidth": bandwidth,
        "start": start,
    }
    for part in args.parts.split(","):
        held[part] = work[part](args.repeats)
        held["about"] = about()
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(json.dumps(held, indent=1))
    text = report(held)
    print(text)
    if args.readme:
        write_readme(text)
    return 0
