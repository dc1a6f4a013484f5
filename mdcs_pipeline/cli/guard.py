"""From whatever ends a command to one message and an exit code."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import typer

from mdcs_pipeline.cli.console import flush, note, say, silence_stdout
from mdcs_pipeline.errors import MdcsError

INTERRUPTED = 130


@dataclass(frozen=True)
class Mode:
    """How faults are told: as JSON on standard output, with a traceback, or neither."""

    json: bool = False
    debug: bool = False
    quiet: bool = False


def guarded(body: Callable[[], Any], mode: Mode) -> int:
    """Run `body` and return the exit code, after telling of whatever went wrong."""
    try:
        with _warnings_as_lines(mode.quiet):
            returned = body()
        flush()
        return returned if isinstance(returned, int) else 0
    except typer.Exit as error:
        flush()
        return error.exit_code
    except (KeyboardInterrupt, typer.Abort):
        return _tell(mode, INTERRUPTED, {"kind": "Interrupted", "what": "interrupted"})
    except BrokenPipeError:
        silence_stdout()
        return 0
    except SystemExit as error:
        # How typer's own help and rich answer a reader that has gone.
        if not isinstance(error.__context__, BrokenPipeError):
            raise
        silence_stdout()
        return 0
    except MdcsError as error:
        if mode.debug:
            _print_traceback()
        return _tell(mode, error.exit_code, _parts(error), f"error: {error}")
    except Exception as error:
        if _is_usage(error):
            return _tell_usage(mode, error)
        return _tell_internal(mode, error)


def _parts(error: MdcsError) -> dict[str, Any]:
    return {
        "kind": type(error).__name__,
        "what": error.what,
        "where": error.where,
        "received": error.received,
        "remedy": error.remedy,
    }


def _is_usage(error: Exception) -> bool:
    # typer brings its own copy of click or uses the installed one, as its version may be.
    return hasattr(error, "format_message") and hasattr(error, "exit_code")


def _tell_usage(mode: Mode, error: Any) -> int:
    context = getattr(error, "ctx", None)
    path = "mdcs" if context is None else context.command_path
    what = error.format_message()
    text = f"error: {what}\n  remedy: see {path} --help"
    return _tell(mode, error.exit_code, {"kind": "UsageError", "what": what}, text)


def _tell_internal(mode: Mode, error: Exception) -> int:
    if mode.debug:
        _print_traceback()
    message = " ".join(str(error).split())
    what = f"{type(error).__name__}: {message}" if message else type(error).__name__
    hint = "" if mode.debug else " (run with --debug for the traceback)"
    return _tell(mode, 1, {"kind": "InternalError", "what": what}, f"internal error: {what}{hint}")


def _print_traceback() -> None:
    import traceback

    note(traceback.format_exc().rstrip())


def _tell(mode: Mode, code: int, fault: dict[str, Any], text: str | None = None) -> int:
    if mode.json:
        try:
            say(json.dumps({"ok": False, "exit_code": code, "error": fault}))
            flush()
            return code
        except BrokenPipeError:
            silence_stdout()
            return code
        except OSError:
            # A full disk behind standard output: the fault can be told elsewhere alone.
            silence_stdout()
    note(text or str(fault["what"]), "red")
    return code


@contextmanager
def _warnings_as_lines(quiet: bool) -> Iterator[None]:
    def told(message: Warning | str, *_: Any, **__: Any) -> None:
        if not quiet:
            note(f"warning: {message}", "yellow")

    with warnings.catch_warnings():
        warnings.showwarning = told
        yield
