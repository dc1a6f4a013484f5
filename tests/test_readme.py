"""README says what is true: its YAML is the shipped file, its Python runs, its stages exist."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import mdcs_pipeline as mdcs
from mdcs_pipeline.demo import demo_cloud
from mdcs_pipeline.stage import stage_names

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def test_the_yaml_is_the_shipped_file() -> None:
    shipped = (ROOT / "configs" / "paper.yaml").read_text(encoding="utf-8")
    assert blocks("yaml") == [shipped.split("\n", 1)[1]]


def test_every_block_of_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    points = demo_cloud(1500)
    space = {"mdcs": mdcs, "points": points, "frames": [(0, points), (1, points)]}
    for block in blocks("python"):
        exec(block, space)
    assert (tmp_path / "wolf.json").exists()
    assert space["skeleton"].header.frame_id == "map"
    assert np.isclose(space["mass"].mass.sum(), 1.0)


def test_the_table_names_every_stage() -> None:
    assert sorted(re.findall(r"^\| `(\w+)` \|", README, flags=re.MULTILINE)) == stage_names()
