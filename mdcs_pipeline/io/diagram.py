"""SVG or PNG: boxes in ranks from top to bottom, joined by labelled arrows."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mdcs_pipeline.errors import MissingExtraError, OutputError
from mdcs_pipeline.io.atomic import write_or_refuse

DIAGRAM_SUFFIXES = (".svg", ".png")

# All lengths in inches.
_WIDTH, _HEIGHT, _COLUMN, _RANK = 1.5, 0.5, 2.2, 1.3
_LANE, _MARGIN = 0.42, 0.3
_FILLS = {"source": "#fde9c8", "stage": "#dbe8f6", "result": "#dff0d8"}
_LINE, _BACK = "#3b4754", "#b0413e"


@dataclass(frozen=True)
class Box:
    """A box: its label, a note below it, its rank from the top, and its kind."""

    label: str
    note: str
    rank: int
    kind: str


@dataclass(frozen=True)
class Arrow:
    """An arrow between two boxes by number; one that leads back is dashed."""

    start: int
    end: int
    label: str
    back: bool


@dataclass(frozen=True)
class _Lane:
    """An arrow that passes ranks by, led along a line beside all boxes."""

    arrow: Arrow
    number: int


def draw_diagram(boxes: Sequence[Box], arrows: Sequence[Arrow], path: Path) -> None:
    """Draw boxes and arrows into a file.

    Arrows from one rank to the next are straight. Those that pass ranks by run beside the
    boxes, forward ones on the left and those that lead back, dashed, on the right.

    Parameters
    ----------
    boxes : sequence of Box
        At least one.
    arrows : sequence of Arrow
    path : Path
        ``.svg`` or ``.png``.

    Raises
    ------
    OutputError
        If the suffix is another or the file cannot be written; then no file is left.
    MissingExtraError
        If matplotlib is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in DIAGRAM_SUFFIXES:
        raise OutputError(
            f"no picture format of a graph has the suffix '{path.suffix}'",
            where=str(path),
            remedy="known suffixes: " + ", ".join(DIAGRAM_SUFFIXES),
        )
    write_or_refuse(path, _picture(boxes, _joined(arrows), suffix[1:]))


def _picture(boxes: Sequence[Box], arrows: Sequence[Arrow], form: str) -> bytes:
    try:
        from matplotlib import rc_context
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError(
            "a picture of a graph needs matplotlib",
            received=str(error),
            remedy="pip install 'mdcs-pipeline[draw]'",
        ) from error
    places = _places(boxes, arrows)
    straight = [a for a in arrows if not a.back and boxes[a.end].rank == boxes[a.start].rank + 1]
    lanes = {
        back: _lanes([a for a in arrows if a.back is back and a not in straight], places)
        for back in (False, True)
    }
    right = max(x for x, _ in places) + _COLUMN / 2
    sides = {back: 1 + max((lane.number for lane in lanes[back]), default=-1) for back in lanes}
    left, top = -right - sides[False] * _LANE, _HEIGHT / 2 + _MARGIN
    width = right + sides[True] * _LANE + _MARGIN - left + _MARGIN
    height = top - min(y for _, y in places) + top
    figure = Figure(figsize=(width, height), dpi=150, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    panel = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    panel.set_axis_off()
    panel.set(xlim=(left - _MARGIN, left - _MARGIN + width), ylim=(top - height, top))
    for arrow in straight:
        _draw_straight(panel, arrow, places)
    for lane in (*lanes[False], *lanes[True]):
        _draw_lane(panel, lane, places, right)
    for box, place in zip(boxes, places, strict=True):
        _draw_box(panel, box, place)
    stream = io.BytesIO()
    # A fixed salt and no date: the same graph gives the same bytes.
    with rc_context({"svg.hashsalt": "mdcs", "svg.fonttype": "none"}):
        metadata = {"Date": None} if form == "svg" else None
        canvas.print_figure(stream, format=form, metadata=metadata)
    return stream.getvalue()


def _joined(arrows: Sequence[Arrow]) -> list[Arrow]:
    """Return the arrows, with those between the same boxes made one."""
    labels: dict[tuple[int, int, bool], list[str]] = {}
    for arrow in arrows:
        labels.setdefault((arrow.start, arrow.end, arrow.back), []).append(arrow.label)
    return [Arrow(start, end, "\n".join(held), back) for (start, end, back), held in labels.items()]


def _places(boxes: Sequence[Box], arrows: Sequence[Arrow]) -> list[tuple[float, float]]:
    """Return the centre of each box; within a rank they stand below what leads to them."""
    across = [0.0] * len(boxes)
    for rank in sorted({box.rank for box in boxes}):
        members = [k for k, box in enumerate(boxes) if box.rank == rank]
        above = {k: [across[a.start] for a in arrows if a.end == k and not a.back] for k in members}
        members.sort(key=lambda k: sum(above[k]) / max(len(above[k]), 1))
        for column, k in enumerate(members):
            across[k] = (column - (len(members) - 1) / 2) * _COLUMN
    return [(x, -box.rank * _RANK) for x, box in zip(across, boxes, strict=True)]


def _lanes(arrows: Sequence[Arrow], places: Sequence[tuple[float, float]]) -> list[_Lane]:
    """Give each arrow the innermost lane that is free beside all the ranks it passes."""
    taken: list[list[tuple[float, float]]] = []
    lanes = []

    def span(arrow: Arrow) -> tuple[float, float]:
        low, high = sorted((places[arrow.start][1], places[arrow.end][1]))
        return low, high

    for arrow in sorted(arrows, key=lambda a: span(a)[1] - span(a)[0]):
        low, high = span(arrow)
        free = (n for n, held in enumerate(taken) if all(high <= a or b <= low for a, b in held))
        number = next(free, len(taken))
        # A label of several lines takes as many lanes, so that the next one clears it.
        wide = number + 1 + arrow.label.count("\n") // 3
        taken.extend([] for _ in range(wide - len(taken)))
        for held in taken[number:wide]:
            held.append((low, high))
        lanes.append(_Lane(arrow, number))
    return lanes


def _draw_box(panel: Any, box: Box, place: tuple[float, float]) -> None:
    from matplotlib.patches import FancyBboxPatch

    x, y = place
    rounding = 0.06 if box.kind == "stage" else _HEIGHT / 2.2
    panel.add_patch(
        FancyBboxPatch(
            (x - _WIDTH / 2 + rounding, y - _HEIGHT / 2 + rounding),
            _WIDTH - 2 * rounding,
            _HEIGHT - 2 * rounding,
            boxstyle=f"round,pad={rounding}",
            facecolor=_FILLS[box.kind],
            edgecolor=_LINE,
            zorder=3,
        )
    )
    lift = 0.08 if box.note else 0.0
    style = {"ha": "center", "va": "center", "zorder": 4}
    panel.text(x, y + lift, box.label, fontsize=10, color="black", **style)
    if box.note:
        panel.text(x, y - 0.11, box.note, fontsize=7.5, color=_LINE, style="italic", **style)


def _draw_straight(panel: Any, arrow: Arrow, places: Sequence[tuple[float, float]]) -> None:
    (x0, y0), (x1, y1) = places[arrow.start], places[arrow.end]
    points = [(x0, y0 - _HEIGHT / 2), (x1, y1 + _HEIGHT / 2)]
    _draw_line(panel, points, arrow)
    middle = ((x0 + x1) / 2, (y0 + y1) / 2)
    _draw_label(panel, arrow, middle, 0)


def _draw_lane(
    panel: Any, lane: _Lane, places: Sequence[tuple[float, float]], right: float
) -> None:
    arrow = lane.arrow
    side = 1 if arrow.back else -1
    beside = side * (right + lane.number * _LANE)
    (x0, y0), (x1, y1) = places[arrow.start], places[arrow.end]
    # Out below the middle and in above it when going down, so that both keep apart.
    shift = _HEIGHT / 5 if y1 < y0 or y1 == y0 else -_HEIGHT / 5
    out, into = y0 - shift, y1 + shift
    edge = side * _WIDTH / 2
    points = [(x0 + edge, out), (beside, out), (beside, into), (x1 + edge, into)]
    _draw_line(panel, points, arrow)
    _draw_label(panel, arrow, (beside, (out + into) / 2), 90)


def _draw_line(panel: Any, points: Sequence[tuple[float, float]], arrow: Arrow) -> None:
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.path import Path as Line

    panel.add_patch(
        FancyArrowPatch(
            path=Line(_rounded(points), _codes(len(points))),
            arrowstyle="-|>",
            mutation_scale=11,
            color=_BACK if arrow.back else _LINE,
            linestyle="--" if arrow.back else "-",
            linewidth=1.1,
            shrinkA=0,
            shrinkB=0,
            zorder=1,
        )
    )


def _rounded(
    points: Sequence[tuple[float, float]], radius: float = 0.12
) -> list[tuple[float, float]]:
    """Return the vertices of a line whose corners are quadratic curves."""
    held = [points[0]]
    for before, corner, after in zip(points, points[1:], points[2:], strict=False):
        held += [_toward(corner, before, radius), corner, _toward(corner, after, radius)]
    return [*held, points[-1]]


def _toward(
    corner: tuple[float, float], other: tuple[float, float], radius: float
) -> tuple[float, float]:
    dx, dy = other[0] - corner[0], other[1] - corner[1]
    part = min(radius / max((dx * dx + dy * dy) ** 0.5, 1e-9), 0.5)
    return corner[0] + part * dx, corner[1] + part * dy


def _codes(corners: int) -> list[int]:
    move, line, curve = 1, 2, 3
    return [move, *[line, curve, curve] * (corners - 2), line]


def _draw_label(panel: Any, arrow: Arrow, place: tuple[float, float], turn: int) -> None:
    panel.text(
        *place,
        arrow.label,
        fontsize=7,
        rotation=turn,
        ha="center",
        va="center",
        color=_BACK if arrow.back else _LINE,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
        zorder=2,
    )
