"""Tables of the results, for the terminal and for benchmarks/README.md."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import mean, median
from typing import Any

from benchmarks.files import put_between

Record = dict[str, Any]
README = Path(__file__).resolve().parents[1] / "README.md"
BEGIN, END = "<!-- topology:begin -->", "<!-- topology:end -->"
TITLES = {
    "shapes": "Shapes with exact ground truth",
    "held-out": "Held-out shapes (never tuned on)",
    "random": "Shapes drawn by chance",
    "random-held-out": "Shapes drawn by chance, never looked at",
    "real": "Real models (components and cycles counted)",
    "table4": "The paper's Table IV (components and cycles counted)",
    "spacing": "Table IV's noise in units of the median spacing",
    "fig13": "The paper's Fig. 13: density ratios",
    "fig14": "The paper's Fig. 14: dumbbell of 736 points",
}


def _unique(records: list[Record], key: str) -> list[str]:
    return list(dict.fromkeys(r[key] for r in records))


def markdown(head: Sequence[str], rows: list[list[str]]) -> str:
    """Return a Markdown table with even columns, so that it reads in a terminal too."""
    table = [list(head), *rows]
    widths = [max(len(row[k]) for row in table) for k in range(len(head))]
    rule = ["-" * widths[0], *("-" * (w - 1) + ":" for w in widths[1:])]

    def line(row: list[str]) -> str:
        cells = [row[0].ljust(widths[0])]
        cells += [c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True)]
        return "| " + " | ".join(cells) + " |"

    return "\n".join(map(line, [table[0], rule, *table[1:]]))


def cell_right(records: list[Record]) -> str:
    """Share of cases without an error, their number, and all errors."""
    if not records:
        return "–"
    right = sum(r["errors"] == 0 for r in records)
    errors = sum(r["errors"] for r in records)
    return f"{100 * right / len(records):.0f} % ({right}/{len(records)}; {errors})"


def average(records: list[Record], key: str, how: Callable[..., float] = mean) -> str:
    """Mean (or another summary) of what is known, with two digits after the point."""
    known = [r[key] for r in records if r.get(key) is not None]
    return f"{how(known):.2f}" if known else "–"


def by(records: list[Record], key: str) -> str:
    """Table of right cases: a row a value of `key`, a column a method."""
    methods = _unique(records, "method")
    rows = []
    for value in [*_unique(records, key), None]:
        chosen = [r for r in records if value is None or r[key] == value]
        cells = [cell_right([r for r in chosen if r["method"] == m]) for m in methods]
        rows.append([value or "all", *cells])
    return markdown([key, *methods], rows)


def agreement(records: list[Record]) -> str:
    """Share of shape x damage pairs in which all seeds give the same counts."""
    groups: dict[tuple[str, str], list[tuple[int, int, int]]] = {}
    for r in records:
        counts = (r["components"], r["cycles"], r["leaves"])
        groups.setdefault((r["shape"], r["damage"]), []).append(counts)
    several = [g for g in groups.values() if len(g) > 1]
    if not several:
        return "–"
    return f"{100 * sum(len(set(g)) == 1 for g in several) / len(several):.0f} %"


def geometry(records: list[Record]) -> str:
    """Table of what is wrong, distances (percent of the diagonal), radius error and time."""
    rows = []
    for name in _unique(records, "method"):
        chosen = [r for r in records if r["method"] == name]
        deltas = [
            str(sum(abs(r[f"delta_{what}"]) for r in chosen))
            for what in ("components", "cycles", "leaves")
        ]
        rows.append(
            [
                name,
                *deltas,
                str(sum(r["failed"] for r in chosen)),
                f"{average(chosen, 'mean_to_truth')} / {average(chosen, 'mean_from_truth')}",
                f"{average(chosen, 'hausdorff_to_truth')} / "
                f"{average(chosen, 'hausdorff_from_truth')}",
                average(chosen, "radius_error"),
                agreement(chosen),
                average(chosen, "seconds", median),
            ]
        )
    head = ("method", "Δcomponents", "Δcycles", "Δleaves", "failed", "mean →/← %",
            "Hausdorff →/← %", "radius error %", "seeds agree", "median s")  # fmt: skip
    return markdown(head, rows)


def per_model(records: list[Record]) -> str:
    """Table of a real model a row: wrong components and cycles, leaves found, mean distances."""
    methods = _unique(records, "method")
    rows = []
    for shape in _unique(records, "shape"):
        cells = []
        for name in methods:
            chosen = [r for r in records if r["shape"] == shape and r["method"] == name]
            wrong = "/".join(str(r["errors"]) for r in chosen)
            leaves = "/".join(str(r["leaves"]) for r in chosen)
            way = f"{average(chosen, 'mean_to_truth')} / {average(chosen, 'mean_from_truth')}"
            cells.append(f"{wrong}; {leaves}; {way}")
        truth = next(r["leaves"] - r["delta_leaves"] for r in records if r["shape"] == shape)
        rows.append([shape, str(truth), *cells])
    return markdown(("model (errors; leaves; mean →/← %)", "true leaves", *methods), rows)


def table4(records: list[Record]) -> str:
    """Table IV as the paper prints it: errors a cell; several seeds are separated by slashes."""
    rows = []
    for shape in _unique(records, "shape"):
        for name in _unique(records, "method"):
            cells = [
                "/".join(
                    str(r["errors"])
                    for r in records
                    if (r["shape"], r["method"], r["damage"]) == (shape, name, damage)
                )
                for damage in _unique(records, "damage")
            ]
            rows.append([f"{shape}, {name}", *cells])
    return markdown(("model, method", *_unique(records, "damage")), rows)


def report(records: list[Record]) -> str:
    """Return the tables of every suite as Markdown."""
    parts = []
    for suite in [s for s in TITLES if s in _unique(records, "suite")]:
        chosen = [r for r in records if r["suite"] == suite]
        parts += [f"### {TITLES[suite]}", "Right (right/all; sum of errors)."]
        if suite == "real":
            parts.append(per_model(chosen))
        elif suite in ("table4", "spacing"):
            parts.append(table4(chosen))
        parts += [by(chosen, "damage"), by(chosen, "shape"), geometry(chosen)]
    return "\n\n".join(parts)


def write_readme(records: list[Record], path: Path = README) -> None:
    """Put the tables between the markers of the README, which is made if it is not there."""
    if not path.exists():
        path.write_text(f"# Benchmarks\n\n## Topology\n\n{BEGIN}\n{END}\n", encoding="utf-8")
    put_between(path, BEGIN, END, report(records))


def main() -> None:
    """Write the tables of a results file: ``python -m benchmarks.topology.table RESULTS``."""
    made = argparse.ArgumentParser(description=__doc__)
    made.add_argument("results", type=Path)
    made.add_argument("--readme", type=Path, default=README)
    args = made.parse_args()
    write_readme(json.loads(args.results.read_text(encoding="utf-8"))["records"], args.readme)


if __name__ == "__main__":
    main()
