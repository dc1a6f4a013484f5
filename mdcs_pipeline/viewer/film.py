"""The frames that a page holds, and which of them it shows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from mdcs_pipeline.arrays import FloatArray
from mdcs_pipeline.io.scene import drawn_points
from mdcs_pipeline.skeleton import Skeleton

KEPT_FRAMES = 200


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame as a page shows it.

    Parameters
    ----------
    label : str
        Name of the file, number or time.
    points : (N, 3) float, optional
        The cloud; of a large one a fixed sample is kept.
    skeleton : Skeleton, optional
        Its ``diagnostics["seconds"]``, by stage, is shown with it.
    settings : mapping, optional
        Of the run that made it, for the file that the user downloads.
    again : callable, optional
        From another value of the dial to the skeleton that it gives, with its settings.
    """

    label: str = ""
    points: FloatArray | None = None
    skeleton: Skeleton | None = None
    settings: Mapping[str, Any] | None = None
    again: Callable[[float], Frame] | None = None


@dataclass(frozen=True)
class Dial:
    """A number that the user may turn, upon which the frame shown is made again.

    Parameters
    ----------
    name : str
        As the page writes it.
    value, low, high : float
        Where it stands, and its ends.
    """

    name: str
    value: float
    low: float
    high: float


@dataclass
class Film:
    """A row of frames, the latest `keep` of them, with a place in it.

    While frames come it follows the latest one, until the user stops it; afterwards it
    plays what it holds from the first to the last.

    Parameters
    ----------
    dial : Dial, optional
    keep : int
        Older frames are forgotten, so that an endless stream does not fill the memory.
    """

    dial: Dial | None = None
    keep: int = KEPT_FRAMES
    live: bool = True
    playing: bool = True
    cursor: int = 0
    first: int = 0
    value: float = 0.0
    _frames: list[Frame] = field(default_factory=list)
    _made: dict[tuple[int, float], Frame] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.value = self.dial.value if self.dial else 0.0

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def last(self) -> int:
        """Number of the latest frame, counted from 0 since the beginning."""
        return self.first + len(self._frames) - 1

    def add(self, frame: Frame) -> None:
        """Append a frame, forgetting the oldest if there are too many."""
        self._frames.append(_thin(frame))
        if len(self._frames) > self.keep:
            del self._frames[0]
            self.first += 1
            self._made = {key: made for key, made in self._made.items() if key[0] >= self.first}
        self.cursor = self.last if self.playing else max(self.cursor, self.first)

    def amend(self, frame: Frame) -> None:
        """Put `frame` in the place of the latest one."""
        self._frames[-1] = _thin(frame)

    def finish(self) -> None:
        """Hear that no more frames come."""
        self.live = self.playing = False

    def toggle(self) -> None:
        """Play or pause."""
        self.playing = not self.playing
        if self.playing and self.live and self._frames:
            self.cursor = self.last
        elif self.playing and self.cursor >= self.last:
            self.cursor = self.first

    def seek(self, number: int) -> None:
        """Show the frame of that number and stay there."""
        self.cursor = min(max(number, self.first), max(self.last, self.first))
        self.playing = False

    def step(self) -> bool:
        """Go on by a frame, if it plays what it holds; stop at the last one."""
        if self.live or not self.playing:
            return False
        self.cursor = min(self.cursor + 1, self.last)
        self.playing = self.cursor < self.last
        return True

    def turn(self, value: float) -> None:
        """Set the dial."""
        self.value = value

    def wanted(self) -> tuple[int, float] | None:
        """Return number and value of the frame shown, if it is still to be made again."""
        if self.dial is None or self.live or not self._frames or self.value == self.dial.value:
            return None
        key = (self.cursor, self.value)
        return key if key not in self._made and self.original().again is not None else None

    def made(self, key: tuple[int, float], frame: Frame) -> None:
        """Keep what was made again; its cloud is the one already there."""
        self._made[key] = replace(frame, points=self._frames[key[0] - self.first].points)
        # Turning the dial to and fro must not fill the memory either.
        while len(self._made) > self.keep:
            del self._made[next(iter(self._made))]

    def original(self) -> Frame:
        """Return the frame at the cursor as it came in."""
        return self._frames[self.cursor - self.first]

    def shown(self) -> Frame | None:
        """Return the frame at the cursor, made with the dial's value if it has been."""
        if not self._frames:
            return None
        return self._made.get((self.cursor, self.value), self.original())


def _thin(frame: Frame) -> Frame:
    return frame if frame.points is None else replace(frame, points=drawn_points(frame.points))
