"""Real dora daemons; left out where dora is not installed."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

if importlib.util.find_spec("dora") is None:
    # Told as skipped by test_dora_skipped.py.
    collect_ignore = ["test_dora.py", "test_documented_flows.py"]


@pytest.fixture(autouse=True)
def _own_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # dora keeps sessions and logs there.
    monkeypatch.setenv("HOME", str(tmp_path))


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Any]:
    from flows import Cluster

    folder = tmp_path / "cluster"
    folder.mkdir()
    made = Cluster(folder)
    yield made
    made.close()
