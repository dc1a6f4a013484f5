"""Letters that have to arrive: sent again until they are acknowledged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from mdcs_pipeline.parts.letters import Letter

# Longer than a letter and its answer take, shorter than anyone likes to wait.
AGAIN_SECONDS = 0.4


@dataclass
class _Sent:
    letter: Letter
    at: float


class Delivery:
    """What one host has sent and not yet heard of.

    Parameters
    ----------
    clock : callable
        Monotonic seconds.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._sent: dict[tuple[int, str], _Sent] = {}

    def keep(self, letter: Letter) -> None:
        """Send a letter again from time to time; of a frame's turns, only the latest."""
        self._sent[letter.frame, _what(letter)] = _Sent(letter, self._clock())

    def got(self, answer: Letter) -> None:
        """Take the acknowledgement of a letter."""
        key = (answer.frame, str(answer.body.get("of")))
        held = self._sent.get(key)
        if held is None:
            return
        sent = held.letter
        if (sent.attempt, sent.body.get("hop")) == (answer.attempt, answer.body.get("hop")):
            del self._sent[key]

    def forget(self, frame: int) -> None:
        """Stop sending the turn of a frame that is over."""
        self._sent.pop((frame, "turn"), None)

    def clear(self) -> None:
        """Stop sending anything."""
        self._sent.clear()

    def due(self) -> list[Letter]:
        """Return the letters that are to be sent again now."""
        now = self._clock()
        late = [sent for sent in self._sent.values() if now - sent.at > AGAIN_SECONDS]
        for sent in late:
            sent.at = now
        return [sent.letter for sent in late]


def answer_to(letter: Letter, host: str) -> Letter:
    """Return what tells a sender that its letter has arrived."""
    body = {"to": letter.sender, "of": _what(letter), "hop": letter.body.get("hop")}
    return Letter("got", host, letter.session, letter.frame, letter.attempt, body)


def _what(letter: Letter) -> str:
    return "turn" if letter.kind == "turn" else "end"
