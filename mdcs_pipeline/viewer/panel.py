"""The panel beside the picture: what the user turns and presses, and what stands there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mdcs_pipeline.viewer.drawing import COLOURINGS, Look
from mdcs_pipeline.viewer.film import Dial, Film
from mdcs_pipeline.viewer.texts import READY, counts_text, legend_text, times_text, title_text


@dataclass(frozen=True)
class Wishes:
    """What the page does when the user asks for it.

    Parameters
    ----------
    seek, turn : callable
        Go by the frame slider, or by the dial.
    toggle, fit, redraw : callable
        Play or pause; let the frame fill the page; draw with another look.
    download : callable of suffix and client
    """

    seek: Callable[[], None]
    turn: Callable[[], None]
    toggle: Callable[[], None]
    fit: Callable[[], None]
    redraw: Callable[[], None]
    download: Callable[[str, Any], None]


class Panel:
    """The controls of one page; shared by all who look at it.

    Parameters
    ----------
    gui : viser.GuiApi
    wishes : Wishes
    dial : Dial, optional
    suffixes : tuple of str
        Formats that can be downloaded.
    """

    def __init__(
        self, gui: Any, wishes: Wishes, dial: Dial | None, suffixes: tuple[str, ...]
    ) -> None:
        self._gui = gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.main_panel.dock_right()
        # What may grow by a line stands below the sliders, or they would slip from the hand.
        self._title = gui.add_markdown("")
        self._frame = gui.add_slider("frame", 1, 2, 1, 1, visible=False)
        self._play = gui.add_button("Pause", visible=False)
        self._dial = self._add_dial(dial)
        self._counts = gui.add_markdown("")
        self._status = gui.add_markdown(READY)
        self._look = _LookControls(gui, wishes.redraw)
        gui.add_button("Fit view").on_click(lambda _: wishes.fit())
        with gui.add_folder("Download"):
            self._suffix = gui.add_dropdown("format", suffixes, initial_value=suffixes[0])
            self._save = gui.add_button("Save skeleton", disabled=True)
        with gui.add_folder("Time"):
            self._times = gui.add_markdown("")
        self._listen(wishes)

    def _add_dial(self, dial: Dial | None) -> Any:
        if dial is None:
            return None
        step = (dial.high - dial.low) / 200
        hint = "makes the frame shown again"
        return self._gui.add_slider(
            dial.name, dial.low, dial.high, step, dial.value, hint=hint, disabled=True
        )

    def _listen(self, wishes: Wishes) -> None:
        self._frame.on_update(_by_user(wishes.seek))
        self._play.on_click(lambda _: wishes.toggle())
        if self._dial is not None:
            self._dial.on_update(_by_user(wishes.turn))
        self._save.on_click(lambda event: wishes.download(self._suffix.value, event.client))

    @property
    def place(self) -> int:
        """Number of the frame at which the slider stands."""
        return int(self._frame.value) - 1

    @property
    def dialled(self) -> float:
        """Where the dial stands."""
        return float(self._dial.value)

    @property
    def look(self) -> Look:
        """How the user wants frames drawn."""
        return self._look.value

    def refresh(self, film: Film) -> None:
        """Let all that stands there agree with the film."""
        frame = film.shown()
        if frame is None:
            return
        self._title.content = title_text(film, frame)
        self._counts.content = counts_text(frame)
        self._times.content = times_text(frame.skeleton)
        self._look.legend.content = legend_text(frame.skeleton, self.look.colouring)
        self._save.disabled = frame.skeleton is None
        if len(film) > 1:
            self._frame.max, self._frame.min = film.last + 1, film.first + 1
            self._frame.value = film.cursor + 1
        self._frame.visible = len(film) > 1
        self._play.visible = len(film) > 1
        self._play.label = "Pause" if film.playing else "Play"
        if self._dial is not None:
            self._dial.disabled = film.live or film.original().again is None

    def say(self, text: str) -> None:
        """Write the status line, in markdown; without text it says that all is done."""
        self._status.content = text or READY


def _by_user(act: Callable[[], None]) -> Callable[[Any], None]:
    """Return a callback for what the user sets; what the page sets has no client."""

    def heard(event: Any) -> None:
        if event.client is not None:
            act()

    return heard


class _LookControls:
    """The folder that says how frames are drawn."""

    def __init__(self, gui: Any, redraw: Callable[[], None]) -> None:
        look = Look()
        with gui.add_folder("Look"):
            self._colouring = gui.add_dropdown(
                "colour by", COLOURINGS, initial_value=look.colouring
            )
            self.legend = gui.add_markdown("")
            self._tubes = gui.add_checkbox("skeleton", look.tubes)
            self._cloud = gui.add_checkbox("cloud", look.cloud)
            self._tube = gui.add_slider("tube width", 0.1, 2.0, 0.1, look.tube)
            self._point = gui.add_slider("point size", 0.05, 1.0, 0.05, look.point)
        for handle in (self._colouring, self._tubes, self._cloud, self._tube, self._point):
            handle.on_update(_by_user(redraw))

    @property
    def value(self) -> Look:
        return Look(
            colouring=self._colouring.value,
            tube=float(self._tube.value),
            point=float(self._point.value),
            cloud=bool(self._cloud.value),
            tubes=bool(self._tubes.value),
        )
