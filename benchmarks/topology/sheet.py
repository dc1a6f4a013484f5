"""Contact sheets: the cloud in grey, the result in red, the truth in blue."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.topology.cases import Case
from benchmarks.topology.methods import method
from benchmarks.topology.solid import Floats, Ints

# A view from above and aside, in which no axis of a shape points at the eye.
_TURN, _RISE = np.radians(32), np.radians(24)
VIEW = np.array(
    [
        [np.cos(_TURN), np.sin(_TURN), 0],
        [np.sin(_RISE) * np.sin(_TURN), -np.sin(_RISE) * np.cos(_TURN), np.cos(_RISE)],
    ]
)


@dataclass(frozen=True)
class Panel:
    """One picture; graphs are (nodes, edges) or None."""

    title: str
    points: Floats
    truth: tuple[Floats, Ints] | None
    result: tuple[Floats, Ints] | None


def draw(panels: list[Panel], path: Path, columns: int = 6) -> None:
    """Draw the panels into one PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    rows = max(1, -(-len(panels) // columns))
    figure = Figure(figsize=(3.2 * columns, 3.2 * rows), dpi=80)
    FigureCanvasAgg(figure)
    for index, panel in enumerate(panels):
        axes = figure.add_subplot(rows, columns, index + 1)
        flat = panel.points @ VIEW.T
        axes.scatter(flat[:, 0], flat[:, 1], s=0.6, c="0.7", linewidths=0)
        for graph, color, width in ((panel.truth, "tab:blue", 1.0), (panel.result, "red", 1.3)):
            if graph is not None and len(graph[0]):
                nodes = graph[0] @ VIEW.T
                axes.add_collection(LineCollection(nodes[graph[1]], colors=color, linewidths=width))
                if color == "red":
                    axes.scatter(nodes[:, 0], nodes[:, 1], s=3, c=color, linewidths=0)
        axes.set_title(panel.title, fontsize=7)
        axes.set_aspect("equal")
        axes.set_axis_off()
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def _panel(record: dict[str, Any]) -> Panel:
    case = Case(record["suite"], record["shape"], record["damage"], record["seed"])
    truth, points = case.truth(), case.cloud()
    title = (
        f"{case.shape} {case.damage} #{case.seed}\n"
        f"components {record['components']}/{truth.components} "
        f"cycles {record['cycles']}/{truth.cycles} leaves {record['leaves']}/{truth.leaves}"
    )
    try:
        made = method(record["method"])(points.copy())
        result = (made.nodes, made.edges)
    except Exception:
        title, result = f"{title}\n{record['message'][:60]}", None
    return Panel(title, points, (truth.nodes, truth.edges), result)


def draw_failures(records: list[dict[str, Any]], name: str, path: Path, most: int = 48) -> int:
    """Draw up to `most` failures of a method, spread over all of them; return how many failed.

    Results are made again, as the JSON keeps counts only.
    """
    wrong = [r for r in records if r["method"] == name and r["errors"] > 0]
    step = max(1, -(-len(wrong) // most))
    draw([_panel(r) for r in wrong[::step]], path)
    return len(wrong)


def draw_clean(path: Path) -> None:
    """Draw every shape undamaged, with its truth."""
    from benchmarks.topology.shapes import HELD_OUT, SHAPES

    panels = []
    for name, held in [(n, False) for n in SHAPES] + [(n, True) for n in HELD_OUT]:
        case = Case("held-out" if held else "shapes", name, "clean", 0)
        truth = case.truth()
        counts = f"{truth.components} {truth.cycles} {truth.leaves}"
        title = f"{name}{' (held out)' if held else ''}: {counts}"
        panels.append(Panel(title, case.cloud(), (truth.nodes, truth.edges), None))
    draw(panels, path, columns=8)


def main() -> None:
    """Draw a results file's failures, or with --clean all shapes."""
    made = argparse.ArgumentParser(description=__doc__)
    made.add_argument("png", type=Path)
    made.add_argument("--results", type=Path)
    made.add_argument("--method", default="mdcs:default")
    made.add_argument("--most", type=int, default=48)
    made.add_argument("--clean", action="store_true")
    args = made.parse_args()
    if args.clean or args.results is None:
        draw_clean(args.png)
        return
    records = json.loads(args.results.read_text(encoding="utf-8"))["records"]
    print(f"{draw_failures(records, args.method, args.png, args.most)} cases are wrong")


if __name__ == "__main__":
    main()
