"""What the parts of a cut graph write to each other: values, turns and short notes.

A frame has one turn. Who holds it fires the next stage if that is his own, and passes the
turn to the stage's host otherwise, with the ledger: what lies where, all but the values.
Values go out when they are made, to whom the graph leads. So every stage sees what it
would see within one process, in the same order. A network may lose letters: turns and ends
are sent again until they are acknowledged, and values that stay away are asked for.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from mdcs_pipeline.errors import (
    ConfigError,
    InputError,
    MdcsError,
    MissingExtraError,
    OutputError,
    StageError,
)
from mdcs_pipeline.graph import Graph
from mdcs_pipeline.run_state import AWAY, Leads, RunState, Token

VERSION = 1
Kind = Literal["value", "turn", "done", "failed", "hello", "got", "want"]
Key = tuple[str, str, int]

_ERRORS: dict[str, type[MdcsError]] = {
    kind.__name__: kind
    for kind in (ConfigError, InputError, MissingExtraError, OutputError, StageError)
}


@dataclass(frozen=True, eq=False)
class Letter:
    """One message between two parts.

    Parameters
    ----------
    kind : {"value", "turn", "done", "failed", "hello", "got", "want"}
    sender : str
        Host.
    session : int
        When the entry began, in nanoseconds; a later one makes an earlier one void.
    frame, attempt : int
        Running numbers, from 0.
    body : dict
        What JSON can hold, by kind: ``origin, port, version`` of a value; ``to, hop, ledger``
        of a turn; ``error`` of a failure; ``incarnation, ready, graph`` of a hello;
        ``to, of, hop`` of what acknowledges a turn or an end; ``keys`` of values wanted.
    message : object, optional
        Of a value.
    """

    kind: Kind
    sender: str
    session: int
    frame: int = 0
    attempt: int = 0
    body: dict[str, Any] = field(default_factory=dict)
    message: Any = None

    @property
    def key(self) -> Key:
        """What names a value within its frame."""
        return self.body["origin"], self.body["port"], self.body["version"]


def head_text(letter: Letter) -> str:
    """Return all of a letter but its message as JSON."""
    head = {
        "mdcs": VERSION,
        "kind": letter.kind,
        "sender": letter.sender,
        "session": letter.session,
        "frame": letter.frame,
        "attempt": letter.attempt,
        "body": letter.body,
    }
    return json.dumps(head, separators=(",", ":"))


def read_head(text: str) -> Letter:
    """Return the letter of a head, its message still missing.

    Raises
    ------
    InputError
        If it is none, or of another version.
    """
    try:
        head = json.loads(text)
        if head["mdcs"] != VERSION:
            raise InputError(
                "the letter is of another version",
                received=head["mdcs"],
                remedy="run the same mdcs-pipeline on every host",
            )
        letter = Letter(
            kind=head["kind"],
            sender=str(head["sender"]),
            session=int(head["session"]),
            frame=int(head["frame"]),
            attempt=int(head["attempt"]),
            body=dict(head["body"]),
        )
        if letter.kind not in get_args(Kind):
            raise KeyError(letter.kind)
        if letter.kind == "value":
            origin, port, version = letter.key
            _key([origin, port, version])
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        if isinstance(error, MdcsError):
            raise
        raise InputError("what arrived is no letter of a part", received=text) from error
    return letter


def fingerprint(graph: Graph) -> str:
    """Return what names the wiring of a graph and its hosts, whatever its settings."""
    spec = graph.spec
    wiring = [
        sorted((stage.name, stage.stage, stage.host) for stage in spec.stages.values()),
        sorted(f"{edge.name} {edge.slot} {edge.max_rounds}" for edge in graph.edges),
        sorted((name, str(ref)) for name, ref in spec.results.items()),
        list(spec.stages),
    ]
    return hashlib.sha256(json.dumps(wiring).encode()).hexdigest()[:16]


def error_body(error: MdcsError) -> dict[str, Any]:
    """Return an error as a letter holds it."""
    parts = {name: getattr(error, name) for name in ("what", "where", "received", "remedy")}
    return {"kind": type(error).__name__, **parts}


def read_error(body: Mapping[str, Any]) -> MdcsError:
    """Return the error that a letter tells of."""
    kind = _ERRORS.get(str(body.get("kind")), StageError)
    texts = {
        name: None if body.get(name) is None else str(body[name])
        for name in ("where", "received", "remedy")
    }
    return kind(
        str(body.get("what")),
        where=texts["where"],
        received=texts["received"],
        remedy=texts["remedy"],
    )


def write_ledger(frame: RunState) -> dict[str, Any]:
    """Return all of a frame's state but the values."""

    def name(token: Token | None) -> list[Any] | None:
        return None if token is None else list(token.key)

    return {
        "slots": {
            stage: {port: [name(t) for t in slot] for port, slot in desk.slots.items()}
            for stage, desk in frame.desks.items()
        },
        "fresh": [stage for stage, desk in frame.desks.items() if desk.fresh],
        "latest": [name(token) for token in frame.latest.values()],
        "rounds": frame.rounds,
        "firings": frame.firings,
        "seconds": frame.seconds,
        "exhausted": frame.exhausted,
        "notes": frame.notes,
    }


def read_ledger(
    ledger: Mapping[str, Any], graph: Graph, leads: Leads, values: Mapping[Key, Any]
) -> RunState:
    """Return the frame of a ledger, with what values there are.

    Raises
    ------
    InputError
        If it is not one of this graph.
    """
    frame = RunState(graph, leads)

    def token(held: Any) -> Token | None:
        if held is None:
            return None
        key = _key(held)
        return Token(*key, values.get(key, AWAY))

    try:
        for stage, desk in frame.desks.items():
            slots = {port: [token(t) for t in ledger["slots"][stage][port]] for port in desk.slots}
            if any(len(slots[port]) != len(desk.slots[port]) for port in slots):
                raise ValueError("another number of slots")
            desk.slots = slots
            desk.fresh = stage in ledger["fresh"]
        for held in ledger["latest"]:
            origin, port, version = _key(held)
            key = (origin, port, version)
            frame.latest[origin, port] = Token(*key, values.get(key, AWAY))
        frame.rounds = {edge: int(ledger["rounds"][edge]) for edge in frame.rounds}
        frame.firings = {stage: int(ledger["firings"][stage]) for stage in frame.firings}
        frame.seconds = {stage: float(ledger["seconds"][stage]) for stage in frame.seconds}
        frame.exhausted = [str(edge) for edge in ledger["exhausted"]]
        frame.notes = dict(ledger["notes"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            "the ledger is not one of this graph",
            received=str(error),
            remedy="run the same configuration on every host",
        ) from error
    return frame


def wanted_keys(letter: Letter) -> list[Key]:
    """Return the names of the values that a letter asks for.

    Raises
    ------
    InputError
        If they are none.
    """
    try:
        return [_key(held) for held in letter.body["keys"]]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError("the letter names no values", received=str(letter.body)) from error


def _key(held: Any) -> Key:
    origin, port, version = held
    if not (isinstance(origin, str) and isinstance(port, str)) or version != int(version):
        raise ValueError(f"no name of a value: {held}")
    return origin, port, int(version)
