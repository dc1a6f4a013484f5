"""What the metadata promise; `make package` builds and uses the package itself."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    tomllib = pytest.importorskip("tomli")

ROOT = Path(__file__).parent.parent
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = PYPROJECT["project"]
EXTRAS: dict[str, list[str]] = PROJECT["optional-dependencies"]


def names(requirements: list[str]) -> set[str]:
    return {re.split(r"[\[<>=;! ]", text)[0].lower() for text in requirements}


def test_the_two_builds_of_open3d_never_meet() -> None:
    """Both hold the module open3d: one extra each, in no other, and uv is told."""
    builds = {"open3d", "open3d-cpu"}
    for extra, requirements in EXTRAS.items():
        assert names(requirements) & builds == ({extra} & builds)
    assert not names(PROJECT["dependencies"]) & builds
    (conflict,) = PYPROJECT["tool"]["uv"]["conflicts"]
    assert {entry["extra"] for entry in conflict} == builds


def test_what_runs_the_package_has_a_lower_bound() -> None:
    """Without one, `make package` could not try the oldest."""
    used = [text for extra, r in EXTRAS.items() if extra not in ("test",) for text in r]
    for text in [*PROJECT["dependencies"], *used]:
        assert re.match(r"^[\w-]+(\[\w+\])?>=[\d.]+", text), text


def test_the_lowest_python_is_the_first_that_is_declared() -> None:
    declared = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    assert declared == sorted(declared, key=lambda text: int(text[2:]))
    assert PROJECT["requires-python"] == f">={declared[0]}"
    assert PYPROJECT["tool"]["ruff"]["target-version"] == "py" + declared[0].replace(".", "")
    make = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert f"sys.version_info < ({declared[0].replace('.', ', ')})" in make
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert f"Python {declared[0]} to {declared[-1]}" in readme


def test_it_says_that_it_is_typed() -> None:
    assert (ROOT / "mdcs_pipeline" / "py.typed").exists()
    assert "Typing :: Typed" in PROJECT["classifiers"]
