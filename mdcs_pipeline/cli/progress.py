"""What a run is doing, for who waits for it."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING, Any

from rich.console import Console

from mdcs_pipeline.cli.console import err, literal, note
from mdcs_pipeline.hooks import Hook, StageEvent

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from mdcs_pipeline.graph import Graph


class Reporter(Hook):
    """A hook that tells of a run; this one is silent."""

    def __enter__(self) -> Reporter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Leave the terminal as it was."""

    def frame(self, label: str) -> None:
        """Hear which frame comes next."""


class Lines(Reporter):
    """One plain line a firing, for pipes and logs."""

    def __init__(self) -> None:
        self._label = ""

    def frame(self, label: str) -> None:
        """Put the frame's name in front of its lines."""
        self._label = f"{label}: " if label else ""

    def stage_finished(self, event: StageEvent) -> None:
        """Write the line of a firing."""
        words = [f"{event.name} round {event.firing}", *_figures(event.figures)]
        note(f"{self._label}{', '.join(words)}, {event.seconds:.3f} s")


class Bar(Reporter):
    """One line that is drawn anew: stage, round, nodes and ε."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._progress: Progress | None = None
        self._task: TaskID | None = None
        self._label = ""
        self._order: tuple[str, ...] = ()
        self._figures: dict[str, Any] = {}

    def frame(self, label: str) -> None:
        """Name the frame in the line."""
        self._label = label

    def run_started(self, graph: Graph) -> None:
        """Draw the line."""
        self._order = graph.order
        self._figures = {}
        if self._progress is None:
            self._progress = self._make()
            self._progress.start()
        if self._task is not None:
            self._progress.remove_task(self._task)
        total = len(self._order)
        self._task = self._progress.add_task("", total=total, label=self._text(self._label))

    def stage_started(self, name: str, firing: int) -> None:
        """Name the stage at work; the bar stands where it stands in the graph."""
        if self._progress is None or self._task is None:
            return
        words = [f"{name} round {firing}", *_figures(self._figures)]
        self._progress.update(
            self._task,
            completed=self._order.index(name),
            label=self._text(", ".join([*filter(None, [self._label]), *words])),
        )

    def stage_finished(self, event: StageEvent) -> None:
        """Keep the figures for the lines to come."""
        self._figures.update(event.figures)

    def close(self) -> None:
        """Remove the line."""
        if self._progress is not None:
            self._progress.stop()

    def _text(self, text: str) -> Any:
        return literal(text, console=self._console)

    def _make(self) -> Progress:
        from rich.progress import BarColumn, Progress, ProgressColumn, Task, TimeElapsedColumn

        class Label(ProgressColumn):
            def render(self, task: Task) -> Any:
                return task.fields["label"]

        columns = (BarColumn(20), TimeElapsedColumn(), Label())
        # What others print is theirs: a redirected standard output must stay as it is.
        return Progress(
            *columns,
            console=self._console,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        )


class Stopwatch(Hook):
    """Keeps the seconds of every firing, for ``--profile``."""

    def __init__(self) -> None:
        self.began = time.perf_counter()
        self.seconds: dict[str, list[float]] = {}

    def stage_finished(self, event: StageEvent) -> None:
        """Note the seconds of a firing."""
        self.seconds.setdefault(event.name, []).append(event.seconds)


def _figures(figures: dict[str, Any]) -> list[str]:
    words = []
    if figures.get("nodes") is not None:
        words.append(f"{figures['nodes']} nodes")
    if figures.get("epsilon") is not None:
        words.append(f"ε {figures['epsilon']:.4g}")
    return words


def reporter(quiet: bool) -> Reporter:
    """Return what suits: silence, a bar on a terminal, plain lines elsewhere."""
    if quiet:
        return Reporter()
    console = err()
    if console.is_terminal and not console.is_dumb_terminal:
        return Bar(console)
    return Lines()
