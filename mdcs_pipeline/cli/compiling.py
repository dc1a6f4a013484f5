"""Whether the kernels are compiled yet, told from numba's cache without loading numba."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

NOTICE = "compiling the kernels, once: some 30 s (mdcs warmup does it ahead of time)"


def kernels_cached(folder: Path | None = None) -> bool:
    """Return whether numba's cache has an index, no older than its source, for every kernel.

    Parameters
    ----------
    folder : Path, optional
        Of the kernels' sources; the package's own when absent.
    """
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return True
    if folder is None:
        folder = Path(__file__).parent.parent / "kernels" / "compiled"
    newest: dict[str, float] = {}
    for index in _indices(folder):
        module = index.name.partition(".")[0]
        newest[module] = max(newest.get(module, 0.0), index.stat().st_mtime)
    return all(newest.get(p.stem, 0.0) >= p.stat().st_mtime for p in _sources(folder))


def _sources(folder: Path) -> list[Path]:
    texts = {path: path.read_text(encoding="utf-8") for path in folder.glob("*.py")}
    # What is written into its callers has no cache of its own.
    return [p for p, t in texts.items() if t.count("@njit") > t.count('inline="always"')]


def _indices(folder: Path) -> Iterator[Path]:
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        # Then numba looks nowhere else.
        yield from Path(given).rglob("*.nbi")
        return
    yield from (folder / "__pycache__").glob("*.nbi")
    # Where numba goes when the package's folder is read-only.
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    yield from (user / "numba").rglob("*.nbi")
