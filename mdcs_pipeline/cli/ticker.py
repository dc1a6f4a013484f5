"""The line that tells of a stream while it runs."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING

from mdcs_pipeline.cli.console import err, literal, note

if TYPE_CHECKING:
    from rich.live import Live

    from mdcs_pipeline.runner import RunRecord
    from mdcs_pipeline.scene.change import SceneChange


class Ticker:
    """Shows frame, lag, nodes, what changed and the time of the stages.

    Parameters
    ----------
    quiet : bool
        Whether to show nothing. Otherwise it is one line that is drawn anew on a terminal,
        and a plain line a frame elsewhere.
    """

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet
        self._console = err()
        self._live: Live | None = None

    def __enter__(self) -> Ticker:
        console = self._console
        if not self._quiet and console.is_terminal and not console.is_dumb_terminal:
            from rich.live import Live

            self._live = Live(
                console=console, transient=True, redirect_stdout=False, redirect_stderr=False
            )
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def frame(
        self, change: SceneChange, record: RunRecord | None, seconds: float, lag: float
    ) -> None:
        """Show the line of a frame."""
        if self._quiet:
            return
        text = line_of(change, record, seconds, lag)
        if self._live is None:
            note(text)
        else:
            self._live.update(literal(text, console=self._console))


def line_of(change: SceneChange, record: RunRecord | None, seconds: float, lag: float) -> str:
    """Return frame, lag, nodes, changes and the milliseconds of the stages that took any."""
    words = [f"frame {change.header.seq}", f"lag {1e3 * lag:.0f} ms"]
    why = change.figures.get("dropped")
    if why is not None:
        return ", ".join([*words, f"dropped: {why}"])
    words.append(f"{change.figures.get('nodes', 0)} nodes")
    words.append(f"+{len(change.added)} ~{len(change.moved)} -{len(change.removed)}")
    stages = {} if record is None else record.seconds
    slow = [f"{name} {1e3 * s:.0f}" for name, s in stages.items() if s >= 5e-4]
    return ", ".join(words) + f", {1e3 * seconds:.0f} ms" + (f": {' '.join(slow)}" if slow else "")
