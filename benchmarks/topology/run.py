"""Run methods on cases, write every result to one JSON and print the tables.

``python -m benchmarks.topology --method mdcs:default --method pygel --seeds 3 --jobs 2``
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from benchmarks.files import write_whole
from benchmarks.topology import models
from benchmarks.topology.cases import Case, select
from benchmarks.topology.methods import method
from benchmarks.topology.pool import Record, run_tasks
from benchmarks.topology.sheet import draw_failures
from benchmarks.topology.table import report, write_readme

RESULTS = Path(__file__).resolve().parents[1] / "results" / "topology.json"


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    made = argparse.ArgumentParser(prog="python -m benchmarks.topology", description=__doc__)
    add = made.add_argument
    add("--method", action="append", dest="methods", metavar="NAME",
        help="mdcs:CONFIG[+STAGE.SETTING=VALUE..], mdcs:without-STAGE, pygel, pygel-raw, "
        "pygel-ls, pygel-ls-raw, pc-skeletor, pc-skeletor-pruned; several are "
        "allowed (default mdcs:default)")  # fmt: skip
    add(
        "--suites",
        default="shapes",
        metavar="RE,..",
        help="shapes, held-out, random, random-held-out, real, table4, spacing, fig13, fig14 or .*",
    )
    add("--shapes", metavar="RE,..", help="only shapes (or models) whose whole name matches")
    add("--cases", metavar="RE,..", help="only damages whose whole name matches, as noise-.*")
    add("--seeds", type=int, default=3, help="seeds a case (default 3)")
    add("--first-seed", type=int, default=0, help="the first of them (default 0)")
    add("--jobs", type=int, default=2, help="processes (default 2)")
    add("--timeout", type=float, default=120.0, help="seconds a case may take (default 120)")
    add("--quick", action="store_true", help="one seed, eight shapes, seven damages")
    add("--out", type=Path, default=RESULTS, help=f"JSON of every case (default {RESULTS.name})")
    add("--append", action="store_true", help="keep the other results that --out already holds")
    add("--sheet", type=Path, metavar="PNG", help="draw the failures of the first method")
    add("--readme", action="store_true", help="write the tables into benchmarks/README.md")
    add("--list", action="store_true", help="only name the cases")
    return made


def about() -> dict[str, str]:
    """Return what the results depend on."""
    found = {"python": platform.python_version(), "machine": platform.platform()}
    for name in ("mdcs-pipeline", "numpy", "scipy", "PyGEL3D"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "absent"
    return found


def save(path: Path, records: list[Record]) -> None:
    """Write the results whole or not at all."""
    write_whole(path, json.dumps({"about": about(), "records": records}, indent=0))


def load(path: Path) -> list[Record]:
    """Read the records of a results file."""
    records: list[Record] = json.loads(path.read_text(encoding="utf-8"))["records"]
    return records


def merged(old: list[Record], new: list[Record]) -> list[Record]:
    """Return old and new records, the new in place of the old of the same case and method."""
    keys = ("suite", "shape", "damage", "seed", "method")
    return list({tuple(r[k] for k in keys): r for r in old + new}.values())


def run(cases: list[Case], methods: list[str], jobs: int, timeout: float) -> list[Record]:
    """Run every method on every case, showing progress on stderr."""
    tasks = [(case, name) for case in cases for name in methods]
    records: list[Record] = []
    start, wrong = time.monotonic(), 0
    for made in run_tasks(tasks, methods, jobs, timeout):
        records.append(made)
        wrong += made["errors"] > 0
        if len(records) % 10 == 0 or len(records) == len(tasks):
            spent = time.monotonic() - start
            print(f"\r{len(records)}/{len(tasks)}  wrong {wrong}  {spent:.0f} s ",
                  end="", file=sys.stderr, flush=True)  # fmt: skip
    print(file=sys.stderr)
    order = {task: k for k, task in enumerate(tasks)}
    fields = ("suite", "shape", "damage", "seed")
    return sorted(records, key=lambda r: order[Case(*(r[f] for f in fields)), r["method"]])


def main(argv: list[str] | None = None) -> int:
    """Run the benchmark; return 0 whatever the scores are."""
    args = parser().parse_args(argv)
    methods = args.methods or ["mdcs:default"]
    for name in methods:
        method(name)
    cases = select(args.seeds, args.suites, args.shapes, args.cases, args.quick, args.first_seed)
    if args.list:
        print("\n".join(case.name for case in cases))
        return 0
    if not models.has_data():
        print(f"no data at {models.data_folder()}: real models are left out", file=sys.stderr)
    if not cases:
        print("no case matches the filters", file=sys.stderr)
        return 2
    # One thread a process: times are then comparable, and processes do not fight for cores.
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    records = run(cases, methods, args.jobs, args.timeout)
    kept = load(args.out) if args.append and args.out.exists() else []
    everything = merged(kept, records)
    save(args.out, everything)
    print(report(records))
    if args.sheet:
        draw_failures(records, methods[0], args.sheet)
    if args.readme:
        write_readme(everything)
    return 0
