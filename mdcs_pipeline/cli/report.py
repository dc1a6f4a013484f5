"""What came of a run: for people as tables, for machines as one JSON object."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdcs_pipeline.cli.console import literal, say, show

if TYPE_CHECKING:
    from mdcs_pipeline.runner import RunRecord
    from mdcs_pipeline.skeleton import Skeleton

TOPOLOGY = ("nodes", "edges", "components", "cycles", "leaves", "junctions")


@dataclass(frozen=True)
class Done:
    """One frame that was run.

    Parameters
    ----------
    label : str
        File name of the frame within a sequence, or empty.
    inputs : dict of Path
    points, dropped : int
        Points that entered, and those left out as not finite.
    skeleton : Skeleton or None
        None where the pipeline gives none.
    record : RunRecord
    seconds : float
        Wall time, reading and writing included.
    outputs : list of Path
    firings : dict of list of float
        Seconds of every firing by stage.
    """

    label: str
    inputs: dict[str, Path]
    points: int
    dropped: int
    skeleton: Skeleton | None
    record: RunRecord
    seconds: float
    outputs: list[Path]
    firings: dict[str, list[float]]


def show_summary(done: list[Done], sequence: bool) -> None:
    """Write the closing table: of one cloud by rows, of a sequence a row a frame."""
    from rich.table import Table

    if not sequence:
        table = Table(show_header=False, box=None, pad_edge=False)
        for name, value in _facts(done[0]).items():
            table.add_row(literal(name, "bold"), literal(value))
        show(table)
        _list_outputs(done)
        return
    # Ten columns fit a terminal of 80 letters only when set close.
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("frame", overflow="fold")
    facts = [_facts(item) for item in done]
    names = [name for name in facts[0] if name != "not settled"]
    for name in names:
        table.add_column(name, justify="right", overflow="fold")
    for item, held in zip(done, facts, strict=True):
        cells = [item.label, *(held.get(name, "") for name in names)]
        table.add_row(*(literal(cell) for cell in cells))
    show(table)
    _list_outputs(done)


def _list_outputs(done: list[Done]) -> None:
    # Outside of the table, which would cut a long path.
    for path in dict.fromkeys(path for item in done for path in item.outputs):
        say(f"written     {path}")


def _facts(item: Done) -> dict[str, str]:
    counts = {} if item.skeleton is None else item.skeleton.summary()
    facts = {"points": f"{item.points}", "dropped": f"{item.dropped}"}
    facts.update((name, f"{counts[name]}") for name in TOPOLOGY if name in counts)
    facts["seconds"] = f"{item.seconds:.2f}"
    if item.record.exhausted:
        facts["not settled"] = "bound used up: " + ", ".join(item.record.exhausted)
    return facts


def show_profile(done: list[Done]) -> None:
    """Write where the time went, stage by stage, over all frames."""
    from rich.table import Table

    rows, total = profile_of(done)
    names = ("stage", "firings", "seconds", "share", "slowest round")
    table = Table(*names, box=None, pad_edge=False)
    for column in table.columns[1:]:
        column.justify = "right"
    for name, row in rows.items():
        slowest = f"{row['slowest']:.3f} (round {row['slowest_round']})" if row["firings"] else ""
        table.add_row(
            literal(name, "bold"),
            str(row["firings"] or ""),
            f"{row['seconds']:.3f}",
            f"{row['share']:.1%}",
            slowest,
        )
    table.add_row(literal("total", "bold"), "", f"{total:.3f}", "", "")
    show("", table)
    _show_rounds({name: row["rounds"] for name, row in rows.items()}, total)


def _show_rounds(seconds: dict[str, list[float]], total: float) -> None:
    """Write the seconds of each round, for the stages that the loops fire again."""
    from rich.table import Table

    looped = {name: each for name, each in seconds.items() if len(each) > 1}
    if not looped:
        return
    table = Table(box=None, pad_edge=False)
    for name in ("round", *looped, "share"):
        table.add_column(literal(name), justify="right")
    for k in range(max(map(len, looped.values()))):
        spent = [each[k] if k < len(each) else None for each in looped.values()]
        cells = ("" if value is None else f"{value:.3f}" for value in spent)
        share = sum(value or 0.0 for value in spent) / total if total else 0.0
        table.add_row(str(k + 1), *cells, f"{share:.1%}")
    show("", table)


def profile_of(done: list[Done]) -> tuple[dict[str, dict[str, Any]], float]:
    """Return figures by stage, and the wall time that they are shares of.

    The last entry is what was spent outside of the stages: reading, writing, the runner.
    """
    total = sum(item.seconds for item in done)
    rows: dict[str, dict[str, Any]] = {}
    for name in done[0].record.seconds:
        each = [item.firings.get(name, []) for item in done]
        flat = [(value, k) for values in each for k, value in enumerate(values, 1)]
        slowest, where = max(flat, default=(0.0, 0))
        rows[name] = _row(sum(value for value, _ in flat), total, len(flat), slowest, where)
        rows[name]["rounds"] = [sum(values) for values in zip_longest(*each, fillvalue=0.0)]
    rest = total - sum(row["seconds"] for row in rows.values())
    rows["outside"] = _row(max(rest, 0.0), total, 0, 0.0, 0)
    return rows, total


def _row(seconds: float, total: float, firings: int, slowest: float, where: int) -> dict[str, Any]:
    return {
        "firings": firings,
        "seconds": seconds,
        "share": seconds / total if total else 0.0,
        "slowest": slowest,
        "slowest_round": where,
        "rounds": [],
    }


def as_json(config: str, done: list[Done], sequence: bool, profile: bool) -> dict[str, Any]:
    """Return the report as plain values."""
    report: dict[str, Any] = {"ok": True, "config": config}
    if sequence:
        report["frames"] = [{"frame": item.label, **_plain(item)} for item in done]
    else:
        report.update(_plain(done[0]))
    if profile:
        report["profile"] = profile_of(done)[0]
    return report


def _plain(item: Done) -> dict[str, Any]:
    skeleton, record = item.skeleton, item.record
    return {
        "inputs": {name: str(path) for name, path in item.inputs.items()},
        "points": item.points,
        "dropped": item.dropped,
        "topology": None if skeleton is None else skeleton.summary(),
        "header": None
        if skeleton is None
        else {
            "frame_id": skeleton.header.frame_id,
            "stamp_ns": skeleton.header.stamp_ns,
            "seq": skeleton.header.seq,
        },
        "seconds": {"total": item.seconds, "stages": dict(record.seconds)},
        "firings": dict(record.firings),
        "rounds": dict(record.rounds),
        "exhausted": list(record.exhausted),
        "outputs": [str(path) for path in item.outputs],
    }
