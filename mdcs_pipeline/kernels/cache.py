"""The kernels on disk as numba compiled them, valid for one state of all their sources.

Numba looks at the file of a function alone: one that calls into another file, or has it
written into itself, would go on with what was compiled of the old file after an upgrade in
place. So a folder of compiled kernels holds a digest of all sources, and is emptied when they
are others.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

STAMP = "sources.sha256"


def sources_digest(sources: Path) -> str:
    """Return the SHA-256 of names and contents of all modules in a folder."""
    held = hashlib.sha256()
    for path in sorted(sources.glob("*.py")):
        held.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return held.hexdigest()


def cache_folders(sources: Path, given: str | None) -> list[Path]:
    """Return where numba may keep what it compiled of a folder, in the order that it tries.

    Parameters
    ----------
    sources : Path
    given : str or None
        Of ``NUMBA_CACHE_DIR``; then it looks nowhere else.
    """
    # As numba names it: folders of one name, of several installations, are told apart.
    folder = os.path.abspath(sources)  # noqa: PTH100  # resolve() would follow links
    mark = hashlib.sha1(folder.encode(), usedforsecurity=False).hexdigest()
    name = f"{Path(folder).name}_{mark}"
    if given:
        return [Path(given) / name]
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return [sources / "__pycache__", user / "numba" / name]


def is_current(folder: Path, digest: str) -> bool:
    """Return whether what a folder holds was compiled of the sources of this digest."""
    try:
        return (folder / STAMP).read_text(encoding="ascii") == digest
    except (OSError, ValueError):
        return False


def drop_stale(sources: Path, given: str | None) -> None:
    """Empty the folder that numba will use if it was filled of other sources.

    To be called before the first of the sources is imported.

    Parameters
    ----------
    sources : Path
        Folder of the modules.
    given : str or None
        Of ``NUMBA_CACHE_DIR``.
    """
    digest = sources_digest(sources)
    for folder in cache_folders(sources, given):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK):
                _empty_unless(folder, digest)
                return
        except OSError:
            # Where this cannot write numba cannot either, and goes on to the next.
            continue


def _empty_unless(folder: Path, digest: str) -> None:
    if is_current(folder, digest):
        return
    # Indices first: what they do not name is not read.
    for pattern in ("*.nbi", "*.nbc"):
        for path in folder.glob(pattern):
            path.unlink(missing_ok=True)
    # In one piece, as another process may be reading it.
    part = folder / f"{STAMP}.{os.getpid()}"
    part.write_text(digest, encoding="ascii")
    part.replace(folder / STAMP)
