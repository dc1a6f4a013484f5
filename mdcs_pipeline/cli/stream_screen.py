"""``--view`` of ``mdcs stream``: the scene on a live page, as its frames come."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import compress, count
from typing import TYPE_CHECKING

from mdcs_pipeline.cli.screen import open_page, page_wanted, stay

if TYPE_CHECKING:
    from mdcs_pipeline import frames
    from mdcs_pipeline.cli.stream_plan import Source
    from mdcs_pipeline.graph import Graph
    from mdcs_pipeline.scene.change import SceneChange
    from mdcs_pipeline.stream import Stream
    from mdcs_pipeline.viewer.film import Frame
    from mdcs_pipeline.viewer.page import LivePage


class StreamScreen:
    """Where a stream shows its scene; this one shows nothing."""

    def now(self) -> float:
        """Return seconds that pass, but for those in which a pause holds the stream up."""
        return time.monotonic()

    def hold(self) -> None:
        """Wait for as long as the user has paused."""

    def goes_on(self) -> None:
        """Hear that frames were taken before, which are not shown."""

    def frame(self, number: int, change: SceneChange, stream: Stream, lag: float) -> None:
        """Hear that the frame of a number, counted from 1, was taken or dropped."""

    def ended(self, stream: Stream) -> None:
        """Hear that what still waited in a scene was worked on."""

    def stay(self) -> None:
        """Wait until the user has seen enough."""


class StreamPage(StreamScreen):
    """A screen that is a live page.

    Parameters
    ----------
    page : LivePage
    source : Source
        Read again, from its first frame, for the dial.
    waits : bool
        Whether a pause holds the stream up: a file waits, a sensor does not.
    quiet : bool
    """

    def __init__(self, page: LivePage, source: Source, waits: bool, quiet: bool) -> None:
        self._page = page
        self._source = source
        self._waits = waits
        self._quiet = quiet
        self._replays = waits
        self._used: list[bool] = []
        self._scene = 0

    def now(self) -> float:
        """Return seconds that pass, but for those in which a pause holds the stream up."""
        return self._page.clock() if self._waits else time.monotonic()

    def hold(self) -> None:
        """Wait for as long as the user has paused; a pipe is never held up."""
        if self._waits and self._page.paused:
            self._page.say("paused: no more frames are read until it plays", hurry=True)
            self._page.wait_to_play()

    def goes_on(self) -> None:
        """Offer no dial: what the frames before gave came from a checkpoint."""
        self._replays = False

    def frame(self, number: int, change: SceneChange, stream: Stream, lag: float) -> None:
        """Show the map and the skeleton as this frame leaves them."""
        why = change.figures.get("dropped")
        if self._replays:
            # Those between were lost to overload: a replay must do without them too.
            self._used += [False] * (number - 1 - len(self._used))
            self._used.append(why is None)
        if why is not None:
            self._tell(f"cloud {number} dropped: {why}")
            return
        self._tell(
            f"lag {1e3 * lag:.0f} ms; nodes {len(change.added)} new, {len(change.moved)} moved, "
            f"{len(change.removed)} gone"
        )
        self._show(f"cloud {number}", stream)

    def ended(self, stream: Stream) -> None:
        """Show what the last frames had left undone."""
        self._show("end of the scene", stream, flushed=True)

    def stay(self) -> None:
        """Serve the page until Ctrl-C, which is how it is meant to end."""
        self._page.finish()
        stay(self._page, self._quiet)

    def _tell(self, text: str) -> None:
        from mdcs_pipeline.viewer.texts import plain

        if not self._page.paused:
            self._page.say(plain(text))
        elif not self._waits:
            self._page.say("paused: the stream goes on, this picture stays", hurry=True)

    def _show(self, label: str, stream: Stream, flushed: bool = False) -> None:
        from mdcs_pipeline.viewer.film import Frame
        from mdcs_pipeline.viewer.remake import replayer, timed

        scene, last = stream.scene, stream.last
        points = None if scene.world is None else scene.world.surface()
        skeleton = timed(stream.skeleton(), {} if last is None else last.seconds)
        frame: Frame = Frame(label, points, skeleton, stream.graph.settings())
        if self._replays:
            taken = len(self._used)
            # Without the map, of which the page keeps no more than it draws.
            bare = Frame(label)
            again = replayer(stream.graph, bare, lambda: self._taken(taken), flushed)
            frame = replace(frame, again=again)
        self._page.show(frame, widen=scene.number == self._scene)
        if scene.number != self._scene:
            self._scene = scene.number
            self._page.fit()

    def _taken(self, most: int) -> Iterator[frames.Frame]:
        """Yield the first `most` frames of the source, but for those that were not used."""
        for number, frame in zip(count(1), compress(self._source.since(0), self._used[:most])):
            self._page.say(f"running anew, frame {number} …")
            yield frame


@contextmanager
def open_stream_screen(
    graph: Graph, source: Source, waits: bool, view: bool, host: str | None, port: int | None,
    quiet: bool,
) -> Iterator[StreamScreen]:  # fmt: skip
    """Give the screen that was asked for, and take it down in the end; see `open_screen`."""
    if not page_wanted(view, host, port):
        yield StreamScreen()
        return
    from mdcs_pipeline.viewer.remake import epsilon_dial

    dial = epsilon_dial(graph) if waits else None
    with open_page(graph.spec.name, host, port, quiet, dial) as page:
        yield StreamPage(page, source, waits, quiet)
