"""The page itself: frames in, pictures out, wishes of the user in between."""

from __future__ import annotations

import re
import threading
import time
from types import TracebackType
from typing import Any

from mdcs_pipeline.errors import MdcsError
from mdcs_pipeline.io.write import SKELETON_SUFFIXES, skeleton_bytes
from mdcs_pipeline.viewer.drawing import Drawing
from mdcs_pipeline.viewer.film import KEPT_FRAMES, Dial, Film, Frame
from mdcs_pipeline.viewer.panel import Panel, Wishes
from mdcs_pipeline.viewer.server import LOCAL_HOST, close_server, open_server, page_url
from mdcs_pipeline.viewer.texts import fault_text

# Seconds a frame stays when the page plays what it holds.
_PACE = 0.25
# Seconds between two words of the status line: more than a person reads.
_HUSH = 0.1


class LivePage:
    """A page in the browser that shows frames as they come, and afterwards all it holds.

    Whoever makes frames calls `show` for each, `finish` when there are no more, and then
    `serve`. None of these but `serve` ever waits for the user or a browser, so that a
    page holds up no stream; one that is to stand still with the page calls `wait_to_play`
    before each frame. Methods may be called from any thread.

    Parameters
    ----------
    host : str
        Address to listen on; only this machine can see the page unless told otherwise.
    port : int, optional
        0 takes any that is free; when absent, 8080 or the next one that is free.
    dial : Dial, optional
        A number that makes frames again which bring along how.
    title : str
    keep : int
        Frames that it holds; of more, the oldest are forgotten.

    Raises
    ------
    MissingExtraError
        If viser is not installed.
    InputError
        If it cannot listen there.

    Examples
    --------
    >>> with LivePage() as page:  # doctest: +SKIP
    ...     for points in frames:
    ...         page.show(Frame(points=points, skeleton=pipe.push(points)))
    ...     page.finish()
    ...     page.serve()
    """

    def __init__(
        self,
        host: str = LOCAL_HOST,
        port: int | None = None,
        dial: Dial | None = None,
        title: str = "mdcs",
        keep: int = KEPT_FRAMES,
    ) -> None:
        self._film = Film(dial, keep)
        self._lock = threading.RLock()
        self._wake = threading.Event()
        self._going = threading.Event()
        self._going.set()
        self._stopped, self._lost = 0.0, 0.0
        self._closed = False
        self._spoken = 0.0
        self._server = open_server(host, port, title)
        self.url = page_url(host, self._server.get_port())
        self._drawing = Drawing(self._server)
        wishes = Wishes(
            self._seek, self._turn, self._toggle, self.fit, self._redraw, self._download
        )
        self._panel = Panel(self._server.gui, wishes, dial, SKELETON_SUFFIXES)

    def __enter__(self) -> LivePage:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def paused(self) -> bool:
        """Whether the user has stopped at a frame while more may come."""
        return not self._going.is_set()

    def wait_to_play(self) -> None:
        """Return once the user lets frames go on, at once if they never stopped them."""
        self._going.wait()

    def clock(self) -> float:
        """Return seconds that pass, by `time.monotonic`, unless frames are paused."""
        with self._lock:
            return (self._stopped if self.paused else time.monotonic()) - self._lost

    def show(self, frame: Frame, widen: bool = False) -> None:
        """Add a frame; it is seen at once unless the user has paused.

        Parameters
        ----------
        frame : Frame
        widen : bool
            Let those step back who look from where they were put, if it outgrows the page.
        """
        with self._lock:
            self._film.add(frame)
            if self._film.cursor == self._film.last:
                self._draw(widen)
            else:
                self._panel.refresh(self._film)

    def amend(self, frame: Frame) -> None:
        """Put a frame in the place of the latest one, as when its skeleton is done."""
        with self._lock:
            self._film.amend(frame)
            if self._film.cursor == self._film.last:
                self._draw()

    def fit(self) -> None:
        """Let the frame that is seen fill the page, as another scene than before must."""
        with self._lock:
            frame = self._film.shown()
            if frame is not None:
                self._drawing.fit(frame)
                self._draw()

    def say(self, text: str, hurry: bool = False) -> None:
        """Write the status line; words that follow too fast are left out unless in a hurry."""
        now = time.monotonic()
        if hurry or now - self._spoken >= _HUSH:
            self._spoken = now
            self._panel.say(text)

    def finish(self) -> None:
        """Hear that no more frames come: now they can be played, and made again."""
        with self._lock:
            self._film.finish()
            self._pass()
            self._panel.say("")
            self._panel.refresh(self._film)

    def serve(self) -> None:
        """Answer the user until `close` is called from elsewhere or Ctrl-C is pressed."""
        while not self._closed:
            # Cleared first: a wish that comes while another is being met wakes us again.
            self._wake.clear()
            if not self._remake():
                with self._lock:
                    paced = self._film.step()
                    if paced:
                        self._draw()
                self._wake.wait(_PACE if paced or self._film.playing else None)

    def close(self) -> None:
        """Take the page down."""
        self._closed = True
        self._wake.set()
        self._going.set()
        close_server(self._server)

    def _remake(self) -> bool:
        """Make the frame shown again if the dial asks for it; tell whether it did."""
        with self._lock:
            key = self._film.wanted()
            again = self._film.original().again if key is not None else None
        if key is None or again is None or self._film.dial is None:
            return False
        self.say(f"{self._film.dial.name} = {key[1]:.4g}: running …", hurry=True)
        try:
            made = again(key[1])
        except MdcsError as error:
            self.say(fault_text(error), hurry=True)
            with self._lock:
                # Kept as it was, so that the same fault is not met over and over.
                self._film.made(key, self._film.original())
            return True
        with self._lock:
            self._film.made(key, made)
            self.say("", hurry=True)
            self._draw()
        return True

    def _pass(self) -> None:
        """Let `wait_to_play` go by where the film now stands."""
        stops = self._film.live and not self._film.playing and not self._closed
        if stops and not self.paused:
            self._stopped = time.monotonic()
            self._going.clear()
        elif self.paused and not stops:
            self._lost += time.monotonic() - self._stopped
            self._going.set()

    def _draw(self, widen: bool = False) -> None:
        frame = self._film.shown()
        if frame is not None:
            if widen:
                self._drawing.widen(frame)
            self._drawing.draw(frame, self._panel.look)
            self._panel.refresh(self._film)

    def _redraw(self) -> None:
        with self._lock:
            self._draw()

    def _seek(self) -> None:
        with self._lock:
            # Read only now: events of one drag come in several threads and any order, and
            # whichever is last must find the slider where the user left it.
            self._film.seek(self._panel.place)
            self._pass()
            self._draw()
        self._wake.set()

    def _turn(self) -> None:
        with self._lock:
            self._film.turn(self._panel.dialled)
            self._draw()
        self._wake.set()

    def _toggle(self) -> None:
        with self._lock:
            self._film.toggle()
            self._pass()
            self._draw()
        self._wake.set()

    def _download(self, suffix: str, client: Any) -> None:
        with self._lock:
            frame = self._film.shown()
        if client is None or frame is None or frame.skeleton is None:
            return
        try:
            data = skeleton_bytes(
                frame.skeleton, suffix, cloud=frame.points, settings=frame.settings
            )
        except MdcsError as error:
            self.say(fault_text(error), hurry=True)
            return
        client.send_file_download(file_name(frame.label) + suffix, data, save_immediately=True)


def file_name(label: str) -> str:
    """Return a plain name for a file from the label of a frame."""
    stem = re.sub(r"\.[A-Za-z]{1,4}$", "", label)
    return re.sub(r"[^\w.-]+", "_", stem).strip("._") or "skeleton"
