"""What 30 % more or less of each number in the default configuration costs.

``python -m benchmarks.topology.sensitivity --jobs 2 --readme``: every number of every stage, as
the shipped graph sets it, is made smaller and larger, one at a time, on the same cases.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.files import put_between, write_whole
from benchmarks.topology.cases import QUICK_SHAPES, Case
from benchmarks.topology.score import failed, score
from benchmarks.topology.table import README

RESULTS = Path(__file__).resolve().parents[1] / "results" / "sensitivity.json"
BEGIN, END = "<!-- sensitivity:begin -->", "<!-- sensitivity:end -->"
SHARE = 0.3
# Every stage has something to do in one of these.
DAMAGES = ("noise-0.3", "loss-80", "holes-1.5", "holes-2.5", "outliers-5", "density-7-halves",
           "views-2", "misaligned-2")  # fmt: skip
# Another seed is another sample of the same method, and the power is the cost's, not a measure.
_NO_MEASURE = ("seed", "power")

Change = dict[str, Any]


@dataclass
class Row:
    """How many cases are right with a setting at its value, smaller and larger.

    A side is None where the setting may not have that value.
    """

    setting: str
    value: float
    less: int | None
    more: int | None


def moved(value: float, share: float) -> float:
    """Return a number that much larger; a whole one stays whole, and moves by 1 at least."""
    if isinstance(value, int):
        return value + int(np.sign(share)) * max(1, round(abs(share * value)))
    return value * (1.0 + share)


def numbers() -> dict[str, float]:
    """Return every number of the default configuration, by ``stage.setting``."""
    from mdcs_pipeline import Pipeline

    with Pipeline.from_config("default") as pipeline:
        stages = pipeline.graph.stages
    return {
        f"{name}.{field}": value
        for name, stage in stages.items()
        for field, value in stage.settings.model_dump().items()
        if isinstance(value, int | float)
        and not isinstance(value, bool)
        and value
        and field not in _NO_MEASURE
    }


def allowed(change: Change) -> bool:
    """Return whether the configuration takes these settings."""
    from mdcs_pipeline import Pipeline
    from mdcs_pipeline.errors import ConfigError

    try:
        Pipeline.from_config("default", **change).close()
    except ConfigError:
        return False
    return True


def right(changes: list[Change], case: Case) -> list[bool]:
    """Return whether the case's topology is right under each of the changes."""
    import mdcs_pipeline
    from mdcs_pipeline.errors import MdcsError

    points, truth = case.cloud(), case.truth()
    told = []
    for change in changes:
        try:
            made = mdcs_pipeline.skeletonize(points, config="default", **change)
            scored = score(made.nodes, made.edges, made.radius, truth)
        except MdcsError:
            scored = failed(truth)
        told.append(scored.errors == 0)
    return told


def measure(cases: list[Case], jobs: int, only: str = "") -> tuple[int, list[Row]]:
    """Return how many cases are right as shipped, and the row of each setting that matches."""
    values = {name: value for name, value in numbers().items() if re.search(only, name)}
    sides = [({name: moved(v, -SHARE)}, {name: moved(v, SHARE)}) for name, v in values.items()]
    changes = [change for pair in sides for change in pair if allowed(change)]
    with ProcessPoolExecutor(jobs) as pool:
        told = np.array(list(pool.map(partial(right, [{}, *changes]), cases)))
    counts = told.sum(axis=0).tolist()
    found = {json.dumps(change): n for change, n in zip(changes, counts[1:], strict=True)}
    rows = [
        Row(name, value, found.get(json.dumps(less)), found.get(json.dumps(more)))
        for (name, value), (less, more) in zip(values.items(), sides, strict=True)
    ]
    return counts[0], rows


def table(cases: int, base: int, rows: list[Row]) -> str:
    """Return the table in Markdown: points won or lost, the worst first."""

    def points(count: int | None) -> float:
        return 0.0 if count is None else 100.0 * (count - base) / cases

    def cell(count: int | None) -> str:
        return "–" if count is None else f"{points(count):+.1f}"

    worst = sorted(rows, key=lambda row: min(points(row.less), points(row.more)))
    lines = [
        f"{base} of {cases} right as shipped. Points of 100 gained or lost by 30 % less and more:",
        "",
        "| setting | value | −30 % | +30 % |",
        "| --- | ---: | ---: | ---: |",
    ]
    still = []
    for row in worst:
        if row.less in (base, None) and row.more in (base, None):
            still.append(f"`{row.setting}`")
        else:
            lines.append(
                f"| `{row.setting}` | {row.value:g} | {cell(row.less)} | {cell(row.more)} |"
            )
    return "\n".join([*lines, "", f"The count stays the same with {', '.join(sorted(still))}."])


def main(argv: list[str] | None = None) -> int:
    """Run it; return 0 whatever it finds."""
    made = argparse.ArgumentParser(description=__doc__)
    made.add_argument("--seeds", type=int, default=1)
    made.add_argument("--jobs", type=int, default=2)
    made.add_argument("--out", type=Path, default=RESULTS)
    made.add_argument("--only", default="", help="regular expression for ``stage.setting``")
    made.add_argument("--readme", action="store_true")
    args = made.parse_args(argv)
    if args.only and args.readme:
        made.error("README's table is of all settings: leave out --only or --readme")
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    cases = [
        Case("shapes", shape, damage, seed)
        for shape in QUICK_SHAPES
        for damage in DAMAGES
        for seed in range(args.seeds)
    ]
    base, rows = measure(cases, args.jobs, args.only)
    held = {"cases": len(cases), "right": base, "rows": [asdict(row) for row in rows]}
    write_whole(args.out, json.dumps(held, indent=0))
    text = table(len(cases), base, rows)
    print(text)
    if args.readme:
        put_between(README, BEGIN, END, text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
