"""What happens when frames come faster than they are done."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

from mdcs_pipeline.errors import ConfigError

T = TypeVar("T")


@dataclass(frozen=True)
class Policy:
    """A declared answer to overload.

    Parameters
    ----------
    kind : {"block", "latest", "queue"}
        block: the source waits; latest: only the newest frame waits, an older one is dropped;
        queue: `size` frames wait, and of more the oldest is dropped.
    size : int
        Frames that may wait.
    """

    kind: Literal["block", "latest", "queue"] = "block"
    size: int = 1


def parse_policy(text: str) -> Policy:
    """Return the policy that ``block``, ``latest`` or ``queue:N`` names.

    Raises
    ------
    ConfigError
        If it is none of these.
    """
    kind, colon, size = text.partition(":")
    if kind == "block" and not colon:
        return Policy("block")
    if kind == "latest" and not colon:
        return Policy("latest")
    if kind == "queue" and size.strip().isdecimal() and int(size) > 0:
        return Policy("queue", int(size))
    raise ConfigError(
        "unknown policy for overload",
        received=text,
        remedy="block, latest, or queue:N with N of at least 1",
    )


class Gate(Generic[T]):
    """Stands between one thread that brings values and one that takes them.

    Parameters
    ----------
    policy : Policy

    Attributes
    ----------
    received, dropped : int
        Values that came, and those of them that were dropped for others. What came is what
        was taken, what was dropped and what still waits.
    """

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self.received = 0
        self.dropped = 0
        self._waiting: deque[T] = deque()
        self._change = threading.Condition()
        self._ended = False
        self._error: BaseException | None = None

    def put(self, value: T) -> bool:
        """Bring a value; return False once nobody takes any more."""
        with self._change:
            while self.policy.kind == "block" and len(self._waiting) >= self.policy.size:
                if self._ended:
                    break
                self._change.wait()
            if self._ended:
                return False
            self.received += 1
            self._waiting.append(value)
            while len(self._waiting) > self.policy.size:
                self._waiting.popleft()
                self.dropped += 1
            self._change.notify_all()
            return True

    def close(self, error: BaseException | None = None) -> None:
        """Say that no more values come; an error is raised at the taker once all is taken."""
        with self._change:
            self._ended = True
            self._error = self._error or error
            self._change.notify_all()

    def __iter__(self) -> Iterator[T]:
        while True:
            with self._change:
                while not self._waiting and not self._ended:
                    self._change.wait()
                if not self._waiting:
                    if self._error is not None:
                        raise self._error
                    return
                value = self._waiting.popleft()
                self._change.notify_all()
            yield value
