"""The command ``mdcs``: one command a file, and nothing heavy before a command needs it."""

from __future__ import annotations

import gc
import sys
from collections.abc import Sequence
from typing import NoReturn

# New objects between two searches for cycles, for Python's 700: imports make a million objects
# that stay, and going through them again and again is a tenth of a short command's time.
_OBJECTS = 50_000


def main(args: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and leave the process with its exit code.

    Parameters
    ----------
    args : sequence of str, optional
        Those of the process when absent.

    Raises
    ------
    SystemExit
        0; 2 for usage or input errors; 1 for failures; 130 after Ctrl-C.
    """
    gc.set_threshold(_OBJECTS, *gc.get_threshold()[1:])
    try:
        from mdcs_pipeline.cli.app import app

        app(args=list(sys.argv[1:] if args is None else args), prog_name="mdcs")
    except KeyboardInterrupt:
        # Ctrl-C while typer itself was being imported.
        sys.exit(130)
    sys.exit(0)
