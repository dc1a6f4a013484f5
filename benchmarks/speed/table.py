"""The figures as tables, each beside what was asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks.files import put_between

README = Path(__file__).resolve().parents[1] / "README.md"
BEGIN, END = "<!-- speed:begin -->", "<!-- speed:end -->"
Figures = dict[str, Any]


def grid(rows: list[list[str]]) -> list[str]:
    """Return a Markdown table; the first row is its head."""
    head, *body = [f"| {' | '.join(row)} |" for row in rows]
    return [head, "| --- |" + " ---: |" * (len(rows[0]) - 1), *body, ""]


def ratio(one: Figures, other: Figures, key: str = "cpu") -> str:
    """Return how many times `other` takes what `one` takes."""
    if key not in one or key not in other:
        return "–"
    return f"{other[key] / one[key]:.3g} x"


def _seconds(found: Figures) -> list[str]:
    if "cpu" not in found:
        return [f"absent: {found.get('missing', '')}", "", "", ""]
    memory = f"{found['peak_mb']:.0f}" if "peak_mb" in found else ""
    whole = f"{found['process_cpu']:.2f}" if "process_cpu" in found else ""
    return [f"{found['cpu']:.3f}", f"{found['wall']:.3f}", memory, whole]


HEAD = ["", "CPU s", "wall s", "MB above input", "CPU s of the process"]


def transport(found: Figures) -> list[str]:
    """Return the section on one transport problem."""
    names = {
        "ours": "mdcs, default",
        "ours-tight": "mdcs, tight",
        "pot": "POT `sinkhorn`",
        "pot-log": "POT `sinkhorn_log` (reckoned from 3 passes)",
    }
    rows = [[*HEAD, "times ours", "memory, times ours"]]
    for key, name in names.items():
        one = found[key]
        shares = [ratio(found["ours"], one), ratio(found["ours"], one, "peak_mb")]
        rows.append([name, *_seconds(one), *shares])
    passes = found["passes"]
    lines = ["**One problem**: n = 15,585, m = 1,558, ε = 0.001, to a marginal error of 1e-3", ""]
    lines += grid(rows)
    ours, plain, worst = (passes[key] for key in ("ours", "plain", "worst_share"))
    lines += [
        f"Passes, {passes['problems']} problems, {passes['failed']} failed: to 1e-3 "
        f"{ours[0]:.0f} of plain Sinkhorn's {plain[0]:.0f} ({ours[0] / plain[0]:.1%}, worst "
        f"{worst[0]:.1%}); to 1e-6 {ours[1]:.0f} of {plain[1]:.0f} ({ours[1] / plain[1]:.1%}, "
        f"worst {worst[1]:.1%}).",
        "",
        "**Accuracy** on that problem: L1 error of the plan against one solved to 1e-10.",
        "",
    ]
    table = [["tolerance", "cut", "error of the plan", "CPU s", "passes"]]
    table += [
        [f"{tolerance:.0e}", f"{cut:.0e}", f"{error:.5f}", f"{cpu:.3f}", str(count)]
        for tolerance, cut, error, cpu, count in found["accuracy"]
    ]
    return lines + grid(table)


def skeleton(found: Figures) -> list[str]:
    """Return the section on the armadillo."""
    rows = [[*HEAD, "times ours"]]
    rows += [[name, *_seconds(one), ratio(found["mdcs"], one)] for name, one in found.items()]
    return ["**End to end**: the 21,622 vertices of the armadillo, kernels warm", "", *grid(rows)]


def growth(found: Figures) -> list[str]:
    """Return the section on one object with ever more points."""
    rows = [["points", *HEAD[1:], "times the smallest"]]
    least = next(iter(found.values()))
    rows += [[name, *_seconds(one), ratio(least, one)] for name, one in found.items()]
    return ["**Growth**: the armadillo sampled ever more densely (float32)", "", *grid(rows)]


def scene(found: Figures) -> list[str]:
    """Return the section on a scene of copies."""
    rows = [["copies", *HEAD[1:]]]
    rows += [[k, *_seconds(one)] for k, one in found.items() if isinstance(one, dict)]
    title = "**Growth**: copies of the armadillo (20,000 points each) at its own voxel size"
    return [
        title,
        "",
        *grid(rows),
        f"Fitted exponent {found.get('exponent', float('nan')):.2f}.",
        "",
    ]


def bandwidth(found: Figures) -> list[str]:
    """Return the line on the pass."""
    one = found["pass"]
    return [
        f"**Bandwidth**: a Sinkhorn pass reads {one['kernel_mb']:.0f} MB of kernel at "
        f"{one['pass_gb_s']:.1f} GB/s; a copy of it moves {one['copy_gb_s']:.1f} GB/s, reading "
        f"and writing: {one['share']:.0%}.",
        "",
    ]


def start(found: Figures) -> list[str]:
    """Return the section on processes."""
    rows = [["process", "CPU s", "wall s"]]
    rows += [[name, f"{one['cpu']:.2f}", f"{one['wall']:.2f}"] for name, one in found.items()]
    return ["**Start**: whole processes, caches warm", "", *grid(rows)]


def report(held: Figures) -> str:
    """Return all sections that there are figures for."""
    sections = {
        "transport": transport,
        "skeleton": skeleton,
        "growth": growth,
        "scene": scene,
        "bandwidth": bandwidth,
        "start": start,
    }
    machine = "; ".join(f"{key} {value}" for key, value in held.get("about", {}).items())
    lines = [f"Machine: {machine}.", ""]
    for name, section in sections.items():
        if name in held:
            lines += section(held[name])
    return "\n".join(lines)


def write_readme(text: str) -> None:
    """Put the tables between their marks."""
    put_between(README, BEGIN, END, text)
