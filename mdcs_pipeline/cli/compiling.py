"""Whether the kernels are compiled yet, told from numba's cache without loading numba."""

from __future__ import annotations

import os
from pathlib import Path

from mdcs_pipeline.kernels.cache import cache_folders, is_current, sources_digest

NOTICE = "compiling the kernels, once: some 30 s (mdcs warmup does it ahead of time)"


def kernels_cached(folder: Path | None = None) -> bool:
    """Return whether numba's cache has an index for every kernel, made of the sources there are.

    Parameters
    ----------
    folder : Path, optional
        Of the kernels' sources; the package's own when absent.
    """
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return True
    if folder is None:
        folder = Path(__file__).parent.parent / "kernels" / "compiled"
    digest, wanted = sources_digest(folder), _modules(folder)
    return any(
        is_current(cache, digest) and wanted <= {p.name.partition(".")[0] for p in _indices(cache)}
        for cache in cache_folders(folder, os.environ.get("NUMBA_CACHE_DIR"))
    )


def _modules(folder: Path) -> set[str]:
    texts = {path.stem: path.read_text(encoding="utf-8") for path in folder.glob("*.py")}
    # What is written into its callers has no cache of its own.
    return {name for name, t in texts.items() if t.count("@njit") > t.count('inline="always"')}


def _indices(cache: Path) -> list[Path]:
    return list(cache.glob("*.nbi"))
