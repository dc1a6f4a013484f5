"""What goes to the terminal, whatever it can show."""

from __future__ import annotations

import codecs
import contextlib
import os
import sys
from typing import Any

from rich.console import Console
from rich.text import Text

PIPE_WIDTH = 120

# Letters of the method and of messages, for a terminal that has ASCII alone.
_PLAIN = {
    "ε": "eps",
    "τ": "tau",
    "θ": "theta",
    "ρ": "rho",
    "ν": "nu",
    "μ": "mu",
    "Δ": "Delta ",
    "√": "sqrt ",
    "²": "^2",
    "→": "->",
    "≤": "<=",
    "≥": ">=",
    "−": "-",
    "–": "-",
    "‖": "|",
    "×": "x",
    "…": "...",
}


def _spelt_out(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lost = error.object[error.start : error.end]
    out = (_PLAIN.get(c) or c.encode("ascii", "backslashreplace").decode() for c in lost)
    return "".join(out), error.end


def prepare_streams() -> None:
    """Make standard output and error take any text, also when closed or ASCII."""
    codecs.register_error("mdcs-plain", _spelt_out)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            # Closed by the caller: there is nowhere to write, which is no reason to fail.
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115, PTH123
            continue
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="mdcs-plain")


class _Piped(Console):
    def on_broken_pipe(self) -> None:
        # rich would end the process with 1; a reader that has seen enough is no failure.
        raise BrokenPipeError


def out() -> Console:
    """Return the console of standard output."""
    console = _Piped(file=sys.stdout, highlight=False)
    # rich takes 80 where there is no terminal; files and pipes have more room than that.
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = PIPE_WIDTH
    return console


def err() -> Console:
    """Return the console of standard error."""
    return _Piped(file=sys.stderr, highlight=False)


def literal(text: object, style: str = "", console: Console | None = None) -> Text:
    """Return `text` for a console, in which no square bracket is taken for markup.

    For a console without Unicode it is spelt out here, so that columns stay straight.
    """
    held = str(text)
    encoding = (console or out()).encoding
    with contextlib.suppress(LookupError):
        held = held.encode(encoding, "mdcs-plain").decode(encoding)
    return Text(held, style=style)


def note(text: str, style: str = "") -> None:
    """Write one line to standard error; where nobody listens any more, to nobody."""
    console = err()
    with contextlib.suppress(OSError):
        console.print(literal(text, style, console), soft_wrap=True)


def say(text: str) -> None:
    """Write plain text to standard output as it is, without wrapping or colour."""
    sys.stdout.write(text if text.endswith("\n") else text + "\n")


def show(*things: Any) -> None:
    """Write tables and texts to standard output."""
    console = out()
    for thing in things:
        console.print(thing)


def flush() -> bool:
    """Flush standard output; return False if its reader has gone."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        silence_stdout()
        return False
    return True


def silence_stdout() -> None:
    """Lead standard output nowhere, so that the interpreter's own last flush is silent."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
