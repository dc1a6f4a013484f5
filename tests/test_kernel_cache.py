"""What numba compiled of one state of the kernels is not used with another."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from mdcs_pipeline.cli.compiling import kernels_cached
from mdcs_pipeline.kernels.cache import STAMP, cache_folders, drop_stale, sources_digest

CALLED = "from numba import njit\n\n@njit(cache=True)\ndef called(x):\n    return x + {}\n"
CALLER = (
    "from numba import njit\nfrom package.called import called\n\n"
    "@njit(cache=True)\ndef caller(x):\n    return called(x)\n"
)
STAMPED = (
    "from pathlib import Path\nfrom numba import config\n"
    "from mdcs_pipeline.kernels.cache import drop_stale\n"
    "drop_stale(Path(__file__).parent, config.CACHE_DIR)\n"
)
USE = (
    "import json; from package.caller import caller as f; y = f(1);"
    "print(json.dumps([y, sum(f.stats.cache_hits.values()), f.stats.cache_path]))"
)


def use(folder: Path, code: str = USE, **environment: str) -> Any:
    """Run code in a process that sees the packages of a folder."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env={**kept, **environment},
        capture_output=True,
        text=True,
        timeout=240,
        check=True,
    )
    return json.loads(done.stdout)


def package(folder: Path, head: str) -> Path:
    made = folder / "package"
    made.mkdir()
    (made / "__init__.py").write_text(head)
    (made / "called.py").write_text(CALLED.format(1))
    (made / "caller.py").write_text(CALLER)
    return made


def upgrade(made: Path) -> None:
    (made / "called.py").write_text(CALLED.format(100))


def test_numba_alone_goes_on_with_the_old_callee(tmp_path: Path) -> None:
    """The fault that the stamp is for: where numba mends it, the stamp can go."""
    made = package(tmp_path, "")
    assert use(tmp_path)[0] == 2
    upgrade(made)
    assert use(tmp_path)[0] == 2


@pytest.mark.parametrize("given", [False, True])
def test_an_upgrade_in_place_is_compiled_anew_and_then_kept(tmp_path: Path, given: bool) -> None:
    made = package(tmp_path, STAMPED)
    where = {"NUMBA_CACHE_DIR": str(tmp_path / "given")} if given else {}
    assert use(tmp_path, **where)[:2] == [2, 0]
    assert use(tmp_path, **where)[:2] == [2, 1]
    upgrade(made)
    value, hits, folder = use(tmp_path, **where)
    assert (value, hits) == (101, 0)
    assert (Path(folder) / STAMP).read_text() == sources_digest(made)
    assert use(tmp_path, **where)[:2] == [101, 1]


@pytest.mark.parametrize("given", [False, True])
def test_the_folder_is_the_one_that_numba_uses(tmp_path: Path, given: bool) -> None:
    """In the package if that can be written to, else in the user's cache, else where it is told."""
    made = package(tmp_path, STAMPED)
    # No folder can be made where a file is.
    (made / "__pycache__").write_text("")
    where = {"XDG_CACHE_HOME": str(tmp_path / "user"), "PYTHONDONTWRITEBYTECODE": "1"}
    if given:
        where["NUMBA_CACHE_DIR"] = str(tmp_path / "given")
    assert use(tmp_path, **where)[0] == 2
    upgrade(made)
    value, _, folder = use(tmp_path, **where)
    assert value == 101
    assert folder.startswith(str(tmp_path / ("given" if given else "user")))
    assert (Path(folder) / STAMP).read_text() == sources_digest(made)


def test_the_package_itself_keeps_its_kernels_so(tmp_path: Path) -> None:
    code = (
        "import json, sys; import mdcs_pipeline; early = 'numba' in sys.modules;"
        "from mdcs_pipeline.kernels.compiled import __file__ as here, heap;"
        "print(json.dumps([early, here, heap.heap_push.stats.cache_path]))"
    )
    early, here, folder = use(tmp_path, code, NUMBA_CACHE_DIR=str(tmp_path / "given"))
    assert not early
    assert (Path(folder) / STAMP).read_text() == sources_digest(Path(here).parent)


def test_only_another_state_of_the_sources_empties_the_folder(tmp_path: Path) -> None:
    sources = tmp_path / "sources"
    sources.mkdir()
    (sources / "one.py").write_text("1\n")
    (folder,) = cache_folders(sources, str(tmp_path / "given"))
    drop_stale(sources, str(tmp_path / "given"))
    held = folder / "one.f-1.py311.nbi"
    held.touch()
    drop_stale(sources, str(tmp_path / "given"))
    assert held.exists()
    (sources / "two.py").write_text("2\n")
    drop_stale(sources, str(tmp_path / "given"))
    assert {path.name for path in folder.iterdir()} == {STAMP}
    # What was there before there were stamps is of an unknown state.
    held.touch()
    (folder / STAMP).write_bytes(b"\xff")
    drop_stale(sources, str(tmp_path / "given"))
    assert not held.exists()
    # Names count as well as contents.
    before = sources_digest(sources)
    (sources / "two.py").rename(sources / "three.py")
    assert sources_digest(sources) != before


def test_nothing_can_be_written_anywhere(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    drop_stale(tmp_path, str(tmp_path / "file"))
    assert (tmp_path / "file").read_bytes() == b""


def test_the_cache_is_whole_only_if_every_kernel_has_an_index_of_these_sources(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    folder = tmp_path / "compiled"
    folder.mkdir()
    for name in ("one", "two"):
        (folder / f"{name}.py").write_text("@njit\ndef f(): ...\n")
    (folder / "types.py").write_text("X = int\n")
    (folder / "within.py").write_text('@njit(inline="always")\ndef f(): ...\n')
    assert not kernels_cached(folder)
    drop_stale(folder, None)
    assert not kernels_cached(folder)
    (folder / "__pycache__" / "one.f-1.py311.nbi").touch()
    assert not kernels_cached(folder)
    (folder / "__pycache__" / "two.f-1.py311.nbi").touch()
    assert kernels_cached(folder)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "given"))
    assert not kernels_cached(folder)
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    # A file that has no kernel counts too: it may have what kernels are made with.
    (folder / "types.py").write_text("X = float\n")
    assert not kernels_cached(folder)
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    assert kernels_cached(folder)
