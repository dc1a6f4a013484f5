"""One host's part of a cut graph: letters in, letters out, no transport of its own."""

from __future__ import annotations

import math
import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mdcs_pipeline.checks import SOURCES
from mdcs_pipeline.errors import InputError, MdcsError, StageError
from mdcs_pipeline.frame import Frame, Token, leads_of
from mdcs_pipeline.graph import Graph
from mdcs_pipeline.hooks import Hook
from mdcs_pipeline.parts.layout import check_host, layout_of
from mdcs_pipeline.parts.letters import (
    Letter,
    error_body,
    fingerprint,
    read_error,
    read_ledger,
    write_ledger,
)
from mdcs_pipeline.parts.state import (
    Ended,
    Flight,
    Result,
    Roster,
    State,
    Step,
    fill,
    prune,
    remember,
)
from mdcs_pipeline.runner import Runner, check_sources, record_of


class Part:
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
        self.layout = layout_of(graph)
        check_host(self.layout, host)
        self.host = host
        self._runner = Runner(graph, hooks)
        self._leads = leads_of(graph)
        self._readers = self.layout.readers()
        self._graph_name = fingerprint(graph)
        self._in_flight, self._frame_seconds = in_flight, frame_seconds
        self._clock = clock
        self._incarnation = secrets.token_hex(4)
        self.session = time.time_ns() if host == self.layout.entry else 0
        self._number = 0
        self._states: dict[int, State] = {}
        self._over: dict[int, float] = {}
        self._flights: dict[int, Flight] = {}
        self._roster = Roster(self.layout.hosts, host, silence)

    def change(self, graph: Graph) -> None:
        """Run the letters to come with other settings of the same graph."""
        self._runner = Runner(graph, self._runner.hooks)

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

    def expire(self) -> Step:
        """Give up frames that take too long."""
        step, now = Step(), self._clock()
        late = [n for n, f in self._flights.items() if now - f.began > self._frame_seconds]
        for number in late:
            error = StageError(
                "the frame was lost on its way",
                received=f"no word of it within {self._frame_seconds:g} s",
                remedy="see which host is slow or gone",
            )
            self._fail(number, self._flights[number].attempt, error, step)
        return step

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
            return step
        if not self._is_current(letter):
            return step
        if letter.kind in ("done", "failed"):
            self._close(letter, step)
            return step
        state = self._states.get(letter.frame)
        if state is None or state.attempt < letter.attempt:
            state = self._states[letter.frame] = State(letter.attempt)
        if state.attempt > letter.attempt:
            return step
        if letter.kind == "value":
            state.values[letter.key] = letter.message
        elif letter.body.get("to") == self.host:
            ledger = letter.body.get("ledger") or {}
            state.frame = read_ledger(ledger, self.layout.graph, self._leads, state.values)
        if state.frame is not None:
            self._advance(letter.frame, state, step)
        return step

    def _is_current(self, letter: Letter) -> bool:
        if self.host != self.layout.entry and letter.session > self.session:
            # The entry has begun anew, and what it had on its way is gone.
            self.session = letter.session
            self._states.clear()
            self._over.clear()
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
        remember(self._over, letter.frame, letter.attempt if failed else math.inf)
        if self._flights.pop(letter.frame, None) is not None:
            error = read_error(letter.body.get("error") or {}) if failed else None
            step.ended.append(Ended(letter.frame, error))

    # The turn.

    def _advance(self, number: int, state: State, step: Step) -> None:
        frame = state.frame
        assert frame is not None
        while (name := frame.next()) is not None:
            if self.layout.host(name) != self.host:
                self._hand_over(number, state, self.layout.host(name), step)
                return
            if not fill(frame.desks[name].tokens(), state.values, frame):
                return
            try:
                tokens = self._runner.fire(name, frame)
            except MdcsError as error:
                self._fail(number, state.attempt, error, step)
                return
            for token in tokens:
                self._spread(number, state, token, step)
            prune(frame, state.values)
        if self.host != self.layout.exit:
            self._hand_over(number, state, self.layout.exit, step)
        else:
            self._finish(number, state, frame, step)

    def _finish(self, number: int, state: State, frame: Frame, step: Step) -> None:
        try:
            tokens = {key: frame.result(key) for key in self.layout.graph.spec.results}
        except MdcsError as error:
            self._fail(number, state.attempt, error, step)
            return
        if not fill(tokens.values(), state.values, frame):
            return
        results = {key: state.values[token.key] for key, token in tokens.items()}
        step.results.append(Result(number, record_of(frame, results), frame.notes))
        self._end(Letter("done", self.host, self.session, number, state.attempt), step)

    def _fail(self, number: int, attempt: int, error: MdcsError, step: Step) -> None:
        body = {"error": error_body(error)}
        self._end(Letter("failed", self.host, self.session, number, attempt, body), step)

    def _end(self, letter: Letter, step: Step) -> None:
        step.letters.append(letter)
        self._close(letter, step)

    def _hand_over(self, number: int, state: State, to: str, step: Step) -> None:
        assert state.frame is not None
        body = {"to": to, "ledger": write_ledger(state.frame)}
        step.letters.append(Letter("turn", self.host, self.session, number, state.attempt, body))
        state.frame = None

    def _spread(self, number: int, state: State, token: Token, step: Step) -> None:
        """Keep a value that was made here, and send it to the hosts that need it."""
        state.values[token.key] = token.value
        if self._readers.get((token.origin, token.port)):
            body = {"origin": token.origin, "port": token.port, "version": token.version}
            step.letters.append(
                Letter("value", self.host, self.session, number, state.attempt, body, token.value)
            )
