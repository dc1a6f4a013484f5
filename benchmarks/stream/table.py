"""The results as lines of a table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.files import put_between

README = Path(__file__).resolve().parents[1] / "README.md"
_BEGIN, _END = "<!-- stream: begin -->", "<!-- stream: end -->"

Row = tuple[str, str, str, bool | None]


def rows_of(found: dict[str, Any]) -> list[Row]:
    """Return what was to be shown, the bound, what was measured, and whether it holds."""
    rows: list[Row] = []
    for part, make in _PARTS.items():
        if found.get(part) is not None:
            rows += make(found[part])
    return rows


def _orbits(orbits: list[dict[str, Any]]) -> list[Row]:
    count = len(orbits)
    streamed = sum(not any(o["streamed"]) for o in orbits)
    cold = sum(not any(o["cold"]) for o in orbits)
    gaps = [o["distance"] for o in orbits]
    ratios, cpu = ([o[name] for o in orbits] for name in ("ratio", "cpu_ratio"))
    entries = [o["cold_entries"] / max(o["entries"], 1.0) for o in orbits]
    return [
        (
            f"right topology after the last of 24 frames, {count} orbits",
            f"≥ cold − {count // 10}",
            f"streamed {streamed}, cold {cold}",
            streamed >= cold - count // 10,
        ),
        (
            "mean distance of streamed from cold, in diagonals",
            "≤ 1.5 %",
            f"{np.mean(gaps):.2f} % (median {np.median(gaps):.2f}, worst {max(gaps):.2f})",
            bool(np.mean(gaps) <= 1.5),
        ),
        (
            "time, cold over a frame of an orbit's second half",
            "≥ 5",
            f"{np.median(ratios):.1f} (by CPU time {np.median(cpu):.1f})",
            bool(np.median(ratios) >= 5.0),
        ),
        (
            "kernel entries of transport, cold over a frame",
            "",
            f"{np.median(entries):.0f}",
            None,
        ),
    ]


def _moment(made: dict[str, Any]) -> Row:
    # The issue asks for the ratio once the scene holds 25 frames; later rows show how it goes on.
    asked = made["frames"] == 25
    cold, frame = made["entries"]
    return (
        f"growing scene, cold over a frame once it holds {made['frames']}",
        "≥ 30" if asked else "",
        f"{made['ratio']:.1f} (CPU {made['cpu_ratio']:.1f}); cold {made['cold_ms']:.0f} ms on "
        f"{made['points']:,} voxels, a frame {made['frame_ms']:.0f} ms on "
        f"{made['region']:,.0f}; kernel entries {cold:,.0f} and {frame:,.0f}",
        made["ratio"] >= 30 if asked else None,
    )


def _grown(grown: dict[str, Any]) -> list[Row]:
    ms = " ".join(f"{1e3 * s:.0f}" for s in grown["quarters"])
    return [
        *(_moment(made) for made in grown["moments"]),
        (
            f"growing scene, {grown['frames']} frames: last quarter over second",
            "≤ 1.2",
            f"{grown['flatness']:.2f} (CPU {grown['cpu_flatness']:.2f}; quarters {ms} ms)",
            grown["flatness"] <= 1.2,
        ),
        (
            "its topology (pieces, loops, ends against the truth)",
            "",
            _signed(grown["streamed"]),
            None,
        ),
        (
            "its memory, second half",
            "grows with the map",
            f"{grown['memory_growth'] / 1e6:.0f} MB; {grown['voxels']} voxels of "
            f"{grown['bytes_per_voxel']:.0f} bytes",
            None,
        ),
    ]


def _slid(slid: dict[str, Any]) -> list[Row]:
    return [
        (
            f"window of 20 frames over {slid['frames']}: memory, last quarter over second",
            "flat",
            f"{100 * slid['memory_growth']:+.1f} %; {slid['voxels'][1]} and "
            f"{slid['voxels'][3]} voxels",
            abs(slid["memory_growth"]) <= 0.05,
        ),
        (
            "its time, last quarter over second",
            "",
            f"{slid['flatness']:.2f} (CPU {slid['cpu_flatness']:.2f})",
            None,
        ),
    ]


def _replaced(made: dict[str, Any]) -> list[Row]:
    return [
        (
            f"a figure that moves, {made['frames']} frames in replace mode",
            "",
            f"right topology in {made['right']}, {100 * made['ids_kept']:.0f} % of ids kept a "
            f"frame, {made['ratio']:.1f} times less than cold",
            None,
        )
    ]


def _live(made: dict[str, Any]) -> list[Row]:
    middle, late, worst = made["latency_ms"]
    cpu = made["cpu_ms"]
    held = made["dropped"] == 0 and late < 100 and made["memory_growth"] < 0.02
    return [
        (
            f"30,000 points at 10 Hz for {made['seconds']:.0f} s",
            "none dropped, p99 < 100 ms, memory flat",
            f"{made['dropped']} of {made['sent']} dropped; latency {middle:.0f}, p99 {late:.0f}, "
            f"worst {worst:.0f} ms (CPU {cpu[0]:.0f}, {cpu[1]:.0f}, {cpu[2]:.0f}); memory "
            f"{100 * made['memory_growth']:+.2f} % in the last half",
            held,
        )
    ]


def _stable(made: dict[str, Any]) -> list[Row]:
    laps, solve = made["laps"], made["solve"]
    return [
        (
            "one pass where nothing changed, and the same plan",
            "1 pass, 1e-4",
            f"{solve['warm_passes']} pass ({solve['cold_passes']} cold), L1 {solve['plan_l1']:.1e}",
            solve["warm_passes"] == 1 and solve["plan_l1"] <= 1e-4,
        ),
        (
            "nodes outside of what changed, bit for bit",
            "identical",
            f"{made['frozen']['changed']} of {made['frozen']['unnamed']:,} differ",
            made["frozen"]["changed"] == 0,
        ),
        (
            f"ids that survive a second lap, {len(laps)} orbits",
            "≥ 95 %",
            f"{100 * np.mean(list(laps.values())):.1f} % (median "
            f"{100 * np.median(list(laps.values())):.1f}, worst {100 * min(laps.values()):.0f})",
            bool(np.mean(list(laps.values())) >= 0.95),
        ),
    ]


def _killed(made: dict[str, Any]) -> list[Row]:
    return [
        (
            f"killed at {made['moments']} random moments and resumed",
            f"{made['moments']} equal",
            f"{made['equal']} equal",
            made["equal"] == made["moments"],
        )
    ]


def _signed(counts: list[int]) -> str:
    return " ".join(f"{n:+d}" for n in counts)


_PARTS = {
    "orbits": _orbits,
    "grown": _grown,
    "slid": _slid,
    "replaced": _replaced,
    "live": _live,
    "stable": _stable,
    "killed": _killed,
}


def table(found: dict[str, Any]) -> str:
    """Return the rows as Markdown."""
    lines = ["| shown | wanted | measured | holds |", "| --- | --- | --- | --- |"]
    words = {True: "yes", False: "**no**", None: ""}
    lines += [f"| {a} | {b} | {c} | {words[d]} |" for a, b, c, d in rows_of(found)]
    return "\n".join(lines)


def orbit_table(orbits: list[dict[str, Any]]) -> str:
    """Return a line for each orbit."""
    lines = [
        "| orbit | voxels | streamed | cold | apart % | frame ms | cold ms | ratio |",
        "| --- | ---: | --- | --- | ---: | ---: | ---: | ---: |",
    ]
    for o in orbits:
        lines.append(
            f"| {o['name']} | {o['voxels']} | {_signed(o['streamed'])} | {_signed(o['cold'])} | "
            f"{o['distance']:.2f} | {1e3 * o['frame_seconds']:.0f} | "
            f"{1e3 * o['cold_seconds']:.0f} | {o['ratio']:.1f} |"
        )
    return "\n".join(lines)


def write_readme(found: dict[str, Any], path: Path = README) -> None:
    """Put the tables between the markers of the README."""
    parts = [table(found)]
    if found.get("orbits"):
        parts.append(orbit_table(found["orbits"]))
    put_between(path, _BEGIN, _END, "\n\n".join(parts))
