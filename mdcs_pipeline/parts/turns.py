"""How a frame's turn moves: stages fire where it is, and it goes where the next one lives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from mdcs_pipeline.errors import MdcsError
from mdcs_pipeline.graph import Graph
from mdcs_pipeline.hooks import Hook
from mdcs_pipeline.parts.delivery import Delivery
from mdcs_pipeline.parts.layout import check_host, layout_of
from mdcs_pipeline.parts.letters import Key, Kind, Letter, error_body, write_ledger
from mdcs_pipeline.parts.state import Result, State, Step, fill, prune
from mdcs_pipeline.run_state import RunState, Token, leads_of
from mdcs_pipeline.runner import Runner, record_of


class Turns:
    """Fires one host's stages and passes the turn; what a `Part` is built on.

    Parameters
    ----------
    graph : Graph
    host : str
    hooks : sequence of Hook
    clock : callable
        Monotonic seconds.
    """

    def __init__(
        self, graph: Graph, host: str, hooks: Sequence[Hook], clock: Callable[[], float]
    ) -> None:
        self.layout = layout_of(graph)
        check_host(self.layout, host)
        self.host = host
        self.session = 0
        self._clock = clock
        self._runner = Runner(graph, hooks)
        self._leads = leads_of(graph)
        self._readers = self.layout.readers()
        self._delivery = Delivery(clock)

    def change(self, graph: Graph) -> None:
        """Run the letters to come with other settings of the same graph."""
        self._runner = Runner(graph, self._runner.hooks)

    def _close(self, letter: Letter, step: Step) -> None:
        """End a frame on this host."""
        raise NotImplementedError

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

    def _finish(self, number: int, state: State, frame: RunState, step: Step) -> None:
        try:
            tokens = {key: frame.result(key) for key in self.layout.graph.spec.results}
        except MdcsError as error:
            self._fail(number, state.attempt, error, step)
            return
        if not fill(tokens.values(), state.values, frame):
            return
        results = {key: state.values[token.key] for key, token in tokens.items()}
        step.results.append(Result(number, record_of(frame, results), frame.notes))
        self._end(self._letter("done", number, state.attempt, {}), step)

    def _fail(self, number: int, attempt: int, error: MdcsError, step: Step) -> None:
        self._end(self._letter("failed", number, attempt, {"error": error_body(error)}), step)

    def _end(self, letter: Letter, step: Step) -> None:
        step.letters.append(letter)
        if self.host != self.layout.entry:
            self._delivery.keep(letter)
        self._close(letter, step)

    def _hand_over(self, number: int, state: State, to: str, step: Step) -> None:
        assert state.frame is not None
        state.hop += 1
        body = {"to": to, "hop": state.hop, "ledger": write_ledger(state.frame)}
        step.letters.append(self._letter("turn", number, state.attempt, body))
        self._delivery.keep(step.letters[-1])
        state.frame = None

    def _spread(self, number: int, state: State, token: Token, step: Step) -> None:
        """Keep a value that was made here, and send it to the hosts that need it."""
        state.values[token.key] = token.value
        if self._readers.get((token.origin, token.port)):
            step.letters.append(self._value(number, state, token.key))

    def _value(self, number: int, state: State, key: Key) -> Letter:
        body = dict(zip(("origin", "port", "version"), key, strict=True))
        return replace(
            self._letter("value", number, state.attempt, body), message=state.values[key]
        )

    def _letter(self, kind: Kind, number: int, attempt: int, body: dict[str, Any]) -> Letter:
        return Letter(kind, self.host, self.session, number, attempt, body)
