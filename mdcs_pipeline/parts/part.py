"""One host's part of a cut graph: letters in, letters out, no transport of its own."""

from __future__ import annotations

import math
import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mdcs_pipeline.checks import SOURCES
from mdcs_pipeline.errors import InputError, StageError
from mdcs_pipeline.graph import Graph
from mdcs_pipeline.hooks import Hook
from mdcs_pipeline.parts.delivery import AGAIN_SECONDS, answer_to
from mdcs_pipeline.parts.letters import (
    Key,
    Letter,
    fingerprint,
    read_error,
    read_ledger,
    wanted_keys,
)
from mdcs_pipeline.parts.state import (
    Ended,
    Flight,
    Roster,
    State,
    Step,
    missing,
    remember,
    state_of,
)
from mdcs_pipeline.parts.turns import Turns
from mdcs_pipeline.run_state import RunState
from mdcs_pipeline.runner import check_sources


class Part(Turns):
    """The stages of one host.

    Parameters
    ----------
    graph : Graph
        All of it, the same on every host; settings of other hosts' stages do not matter.
    host : str
    hooks : sequence of Hook, optional
        Hear of this host's stages.
    in_flight : int
        Frames that the entry has on their way at a time.
    frame_seconds : float
        Time after which a frame that has not ended counts as lost.
    silence : float
        Seconds without a hello after which a host counts as gone.
    clock : callable
        Monotonic seconds.

    Raises
    ------
    ConfigError
        If no stage is on this host.
    """

    def __init__(
        self,
        graph: Graph,
        host: str,
        hooks: Sequence[Hook] = (),
        *,
        in_flight: int = 1,
        frame_seconds: float = 60.0,
        silence: float = math.inf,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(graph, host, hooks, clock)
        self._graph_name = fingerprint(graph)
        self._in_flight, self._frame_seconds = in_flight, frame_seconds
        self._incarnation = secrets.token_hex(4)
        self.session = time.time_ns() if host == self.layout.entry else 0
        self._number = 0
        self._states: dict[int, State] = {}
        self._over: dict[int, float] = {}
        self._flights: dict[int, Flight] = {}
        self._roster = Roster(self.layout.hosts, host, silence)

    def hello(self, ready: bool = True) -> Letter:
        """Return what a host says of itself from time to time, and first of all."""
        body = {"incarnation": self._incarnation, "ready": ready, "graph": self._graph_name}
        return Letter("hello", self.host, self.session, body=body)

    # Of the entry.

    def why_not(self) -> str | None:
        """Return why no frame can begin now, or None if one can."""
        if self.host != self.layout.entry:
            return f"frames begin on the host '{self.layout.entry}'"
        missing = self._roster.missing(self._clock())
        if missing is not None:
            return missing
        if len(self._flights) >= self._in_flight:
            return "frames are still on their way"
        return None

    def begin(self, sources: Mapping[str, Any], notes: Mapping[str, Any] | None = None) -> Step:
        """Send a frame off.

        Parameters
        ----------
        sources : mapping
            A `PointCloud` for each source of the graph.
        notes : mapping, optional
            What JSON can hold, for the exit.

        Raises
        ------
        InputError
            If a source is missing or unknown, or no frame can begin now.
        """
        check_sources(sources, self.layout.graph)
        reason = self.why_not()
        if reason is not None:
            raise InputError(f"the frame cannot begin: {reason}")
        number, self._number = self._number, self._number + 1
        self._flights[number] = Flight(dict(sources), dict(notes or {}), self._clock())
        step = Step()
        self._send_off(number, step)
        return step

    @property
    def under_way(self) -> int:
        """How many frames have begun here and not ended."""
        return len(self._flights)

    def tick(self) -> Step:
        """Send again what may be lost, ask for what stays away, give up what takes too long."""
        step, now = Step(self._delivery.due()), self._clock()
        for number, state in self._states.items():
            if state.frame is not None and now - state.waits > AGAIN_SECONDS:
                state.waits = now
                body = {"keys": [list(key) for key in self._awaited(state.frame, state)]}
                step.letters.append(self._letter("want", number, state.attempt, body))
        late = [n for n, f in self._flights.items() if now - f.began > self._frame_seconds]
        for number in late:
            error = StageError(
                "the frame was lost on its way",
                received=f"no word of it within {self._frame_seconds:g} s",
                remedy="see which host is slow or gone",
            )
            self._fail(number, self._flights[number].attempt, error, step)
        return step

    def _awaited(self, frame: RunState, state: State) -> list[Key]:
        name = frame.next()
        if name is not None:
            return missing(frame.desks[name].tokens(), state.values)
        return missing(map(frame.result, self.layout.graph.spec.results), state.values)

    def _send_off(self, number: int, step: Step) -> None:
        flight = self._flights[number]
        state = State(flight.attempt, frame=self._runner.frame())
        self._states[number] = state
        assert state.frame is not None
        state.frame.notes = flight.notes
        for source, cloud in flight.sources.items():
            token = state.frame.put(f"{SOURCES}.{source}", source, cloud)
            if token is not None:
                self._spread(number, state, token, step)
        self._advance(number, state, step)

    # Letters.

    def receive(self, letter: Letter) -> Step:
        """Take a letter, and go on as far as it lets.

        Raises
        ------
        InputError
            If it is of another graph; nothing has changed then.
        """
        step = Step()
        if letter.sender == self.host:
            return step
        if letter.kind == "hello":
            self._meet(letter, step)
        elif letter.kind == "got":
            if letter.body.get("to") == self.host and letter.session == self.session:
                self._delivery.got(letter)
        elif letter.kind in ("done", "failed"):
            if self.host == self.layout.entry and letter.session == self.session:
                step.letters.append(answer_to(letter, self.host))
            if self._is_current(letter):
                self._close(letter, step)
        elif letter.kind == "turn" and letter.body.get("to") != self.host:
            self._is_current(letter)
        elif self._is_current(letter):
            self._take(letter, step)
        return step

    def _take(self, letter: Letter, step: Step) -> None:
        state = state_of(self._states, letter.frame, letter.attempt)
        if state is None:
            return
        if letter.kind == "want":
            self._send_wanted(letter, state, step)
            return
        if letter.kind == "value":
            state.values[letter.key] = letter.message
        else:
            hop, ledger = int(letter.body.get("hop") or 0), letter.body.get("ledger") or {}
            if hop > state.hop:
                graph = self.layout.graph
                state.frame = read_ledger(ledger, graph, self._leads, state.values)
                state.hop, state.waits = hop, self._clock()
            step.letters.append(answer_to(letter, self.host))
        if state.frame is not None:
            self._advance(letter.frame, state, step)

    def _send_wanted(self, letter: Letter, state: State, step: Step) -> None:
        for key in wanted_keys(letter):
            if key in state.values and self.layout.host(key[0]) == self.host:
                step.letters.append(self._value(letter.frame, state, key))

    def _is_current(self, letter: Letter) -> bool:
        if self.host != self.layout.entry and letter.session > self.session:
            # The entry has begun anew, and what it had on its way is gone.
            self.session = letter.session
            self._states.clear()
            self._over.clear()
            self._delivery.clear()
        return letter.session == self.session and letter.attempt > self._over.get(letter.frame, -1)

    def _meet(self, letter: Letter, step: Step) -> None:
        if letter.body.get("graph") != self._graph_name:
            raise InputError(
                f"the host '{letter.sender}' runs another graph",
                remedy="run the same configuration on every host",
            )
        self._roster.meet(letter, self._clock())
        if self._roster.is_whole_again():
            # What a process before it knew is gone; the frames begin again.
            for number, flight in self._flights.items():
                flight.attempt += 1
                self._send_off(number, step)

    def _close(self, letter: Letter, step: Step) -> None:
        state = self._states.get(letter.frame)
        failed = letter.kind == "failed"
        if failed and state is not None and state.attempt > letter.attempt:
            return
        self._states.pop(letter.frame, None)
        self._delivery.forget(letter.frame)
        remember(self._over, letter.frame, letter.attempt if failed else math.inf)
        if self._flights.pop(letter.frame, None) is not None:
            error = read_error(letter.body.get("error") or {}) if failed else None
            step.ended.append(Ended(letter.frame, error))
