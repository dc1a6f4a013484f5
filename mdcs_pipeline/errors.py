"""Errors that say what went wrong, where, what was received and how to mend it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class MdcsError(Exception):
    """Base of every error that this package raises on purpose.

    Parameters
    ----------
    what : str
        The fault, in one sentence.
    where : str, optional
        Stage, port, file and line, as far as they are known.
    received : object, optional
        The offending value; shortened when it is long.
    remedy : str, optional
        What the user can do about it.
    """

    exit_code = 1

    def __init__(
        self,
        what: str,
        *,
        where: str | None = None,
        received: object = None,
        remedy: str | None = None,
    ) -> None:
        self.what = what
        self.where = where
        self.received = None if received is None else shorten(received)
        self.remedy = remedy
        super().__init__(what)

    def __str__(self) -> str:
        parts = [f"{self.where}: {self.what}" if self.where else self.what]
        if self.received is not None:
            parts.append(f"received: {self.received}")
        if self.remedy:
            parts.append(f"remedy: {self.remedy}")
        return "\n  ".join(parts)

    def located(self, where: str) -> MdcsError:
        """Return the same error with `where` put in front of its place."""
        place = f"{where}, {self.where}" if self.where else where
        return type(self)(self.what, where=place, received=self.received, remedy=self.remedy)


class InputError(MdcsError, ValueError):
    """Points, arrays or files that cannot be used as they are."""

    exit_code = 2


class ConfigError(MdcsError, ValueError):
    """A pipeline description that cannot be built."""

    exit_code = 2


class MissingExtraError(MdcsError, ImportError):
    """A feature whose optional dependency is not installed."""

    exit_code = 2


class OutputError(MdcsError, OSError):
    """A result that cannot be written where it was asked for."""

    exit_code = 2


class StageError(MdcsError, RuntimeError):
    """A stage that failed on valid input."""


def shorten(value: object, limit: int = 120) -> str:
    """Return `value` as text of at most `limit` characters."""
    text = value if isinstance(value, str) else repr(value)
    return text if len(text) <= limit else text[: limit - 1] + "…"


def nearest_name(name: str, known: Iterable[str]) -> str | None:
    """Return the known name closest in spelling to `name`, if any is close."""
    close = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return close[0] if close else None


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return a remedy for an unknown `name`: the nearest right one, or all there are."""
    names = sorted(known)
    close = nearest_name(name, names)
    if close is not None:
        return f"did you mean '{close}'?"
    return "known names: " + (", ".join(names) if names else "none")
