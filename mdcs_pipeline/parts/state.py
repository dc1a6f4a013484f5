"""What a part remembers: frames, values, and the other hosts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mdcs_pipeline.errors import MdcsError
from mdcs_pipeline.parts.letters import Key, Letter
from mdcs_pipeline.run_state import AWAY, RunState, Token
from mdcs_pipeline.runner import RunRecord

# Letters that are still on their way when a frame ends must not open it again.
_REMEMBERED = 256
# Frames whose end was not heard of must not pile up.
_MOST_STATES = 128


@dataclass(frozen=True)
class Ended:
    """The end of a frame, as the entry hears of it; well unless there is an error."""

    frame: int
    error: MdcsError | None = None


@dataclass(frozen=True)
class Result:
    """What came out of a frame, at the exit.

    Parameters
    ----------
    frame : int
    record : RunRecord
    notes : dict
        Those that the frame began with.
    """

    frame: int
    record: RunRecord
    notes: dict[str, Any]


@dataclass
class Step:
    """What comes of one letter.

    Parameters
    ----------
    letters : list of Letter
        To send, in this order.
    results : list of Result
        Frames that came out, at the exit.
    ended : list of Ended
        Frames that are over, at the entry.
    """

    letters: list[Letter] = field(default_factory=list)
    results: list[Result] = field(default_factory=list)
    ended: list[Ended] = field(default_factory=list)


@dataclass
class State:
    """What a host knows of one frame: the values at hand, and the frame if it has the turn.

    Parameters
    ----------
    attempt : int
    hop : int
        Times that the turn had been passed when it was last seen here.
    values : dict
    frame : RunState, optional
    waits : float
        When it began to wait for values.
    """

    attempt: int
    hop: int = 0
    waits: float = 0.0
    values: dict[Key, Any] = field(default_factory=dict)
    frame: RunState | None = None


@dataclass
class Flight:
    """A frame that the entry has sent off."""

    sources: dict[str, Any]
    notes: dict[str, Any]
    began: float
    attempt: int = 0


@dataclass
class _Peer:
    incarnation: str
    ready: bool
    heard: float


class Roster:
    """The other hosts, by what they say of themselves.

    Parameters
    ----------
    hosts : sequence of str
    own : str
        Left out.
    silence : float
        Seconds without a hello after which a host counts as gone.
    """

    def __init__(self, hosts: Sequence[str], own: str, silence: float) -> None:
        self._hosts = [host for host in hosts if host != own]
        self._silence = silence
        self._peers: dict[str, _Peer] = {}
        self._restarted = False

    def meet(self, letter: Letter, now: float) -> None:
        """Take a hello."""
        name, before = str(letter.body.get("incarnation")), self._peers.get(letter.sender)
        self._peers[letter.sender] = _Peer(name, bool(letter.body.get("ready")), now)
        self._restarted |= before is not None and before.incarnation != name

    def missing(self, now: float) -> str | None:
        """Return which host is not there or not ready, or None."""
        for host in self._hosts:
            peer = self._peers.get(host)
            if peer is None or now - peer.heard > self._silence:
                return f"the host '{host}' is not there"
            if not peer.ready:
                return f"the host '{host}' is not ready"
        return None

    def is_whole_again(self) -> bool:
        """Return, once, whether all are ready after one has started anew."""
        whole = self._restarted and all(peer.ready for peer in self._peers.values())
        self._restarted &= not whole
        return whole


def remember(over: dict[int, float], frame: int, attempt: float) -> None:
    """Note that attempts up to this one of a frame are over."""
    over[frame] = max(attempt, over.get(frame, -1))
    while len(over) > _REMEMBERED:
        del over[next(iter(over))]


def state_of(states: dict[int, State], frame: int, attempt: int) -> State | None:
    """Return the state of an attempt, a new one if need be; None if a later one is known."""
    state = states.get(frame)
    if state is None or state.attempt < attempt:
        state = states[frame] = State(attempt)
        while len(states) > _MOST_STATES:
            del states[next(iter(states))]
    return state if state.attempt == attempt else None


def fill(tokens: Iterable[Token], values: Mapping[Key, Any], frame: RunState) -> bool:
    """Put the values at hand into a frame; return whether all of `tokens` have one."""
    missing = {token.key for token in tokens if token.value is AWAY}
    if not missing:
        return True
    if not missing <= values.keys():
        return False

    def filled(token: Token | None) -> Token | None:
        if token is None or token.value is not AWAY or token.key not in values:
            return token
        return Token(*token.key, values[token.key])

    for desk in frame.desks.values():
        desk.slots = {port: [filled(t) for t in slot] for port, slot in desk.slots.items()}
    return True


def missing(wanted: Iterable[Token], values: Mapping[Key, Any]) -> list[Key]:
    """Return the names of the values that are neither in their tokens nor at hand."""
    held = [token for token in wanted if token.value is AWAY and token.key not in values]
    return list(dict.fromkeys(token.key for token in held))


def prune(frame: RunState, values: dict[Key, Any]) -> None:
    """Drop the values of earlier rounds, which nothing holds any more."""
    live = {token.key for desk in frame.desks.values() for token in desk.tokens()}
    newest = {channel: token.version for channel, token in frame.latest.items()}
    for key in [k for k in values if k not in live and k[2] < newest.get(k[:2], 0)]:
        del values[key]
