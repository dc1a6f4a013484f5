"""A worker that always takes the newest item: what it could not get to is counted."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class Counts:
    """What became of the items offered; all that were are in one of the others, or at work.

    Parameters
    ----------
    offered : int
    done : int
        Worked on to the end.
    failed : int
        Worked on, and refused or broken off.
    replaced : int
        Given way to a newer one before their turn came.
    """

    offered: int = 0
    done: int = 0
    failed: int = 0
    replaced: int = 0


class Latest(Generic[T]):
    """One thread that works on the newest item offered.

    Parameters
    ----------
    work : callable
        Takes an item and returns whether it went well; must not raise.
    """

    def __init__(self, work: Callable[[T], bool]) -> None:
        self._work = work
        self._changed = threading.Condition()
        self._waiting: list[T] = []
        self._counts = Counts()
        self._busy = False
        self._thread: threading.Thread | None = None

    @property
    def counts(self) -> Counts:
        """What became of the items so far."""
        with self._changed:
            return self._counts

    def start(self) -> None:
        """Begin to work; items may be offered before."""
        with self._changed:
            if self._thread is not None:
                return
            self._thread = threading.Thread(target=self._run, name="frames", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Finish the item at work, count the one that waits as replaced, and end the thread."""
        with self._changed:
            thread, self._thread = self._thread, None
            self._drop_waiting()
            self._changed.notify_all()
        if thread is not None and thread is not threading.current_thread():
            thread.join()

    def offer(self, item: T) -> None:
        """Give an item, in place of one that still waits."""
        with self._changed:
            self._drop_waiting()
            self._waiting = [item]
            self._counts = replace(self._counts, offered=self._counts.offered + 1)
            self._changed.notify_all()

    def clear(self) -> None:
        """Drop the item that waits and begin the counts again, once the one at work is done."""
        with self._changed:
            self._drop_waiting()
            self._changed.wait_for(lambda: not self._busy)
            self._counts = Counts(offered=len(self._waiting))

    def _drop_waiting(self) -> None:
        gone = len(self._waiting)
        self._waiting = []
        self._counts = replace(self._counts, replaced=self._counts.replaced + gone)

    def _run(self) -> None:
        me = threading.current_thread()
        while (item := self._take(me)) is not None:
            went_well = self._work(item[0])
            with self._changed:
                self._busy = False
                counts = self._counts
                self._counts = (
                    replace(counts, done=counts.done + 1)
                    if went_well
                    else replace(counts, failed=counts.failed + 1)
                )
                self._changed.notify_all()

    def _take(self, me: threading.Thread) -> tuple[T] | None:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._thread is not me)
            if self._thread is not me:
                return None
            (item,) = self._waiting
            self._waiting = []
            self._busy = True
            return (item,)
