"""The default pipeline without one of its ingredients.

A stage that is left out hands on what it got: whoever read its result reads what it read.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import yaml

# What stands for each result of a stage that is left out.
PASSED: dict[str, dict[str, str]] = {
    "clean": {"clean.cloud": "downsample.cloud"},
    "medial": {
        "medial.thickness": "thickness.thickness",
        "medial.surface": "surface.surface",
        "ridge.thickness": "thickness.thickness",
        "ridge.surface": "surface.surface",
    },
    "ridge": {
        "ridge.thickness": "medial.thickness",
        "ridge.surface": "medial.surface",
    },
    "untie": {"untie.rough": "link.rough"},
    "bridge": {"bridge.rough": "check.accepted"},
    "prune": {"prune.rough": "bridge.rough"},
    "junction": {"junction.rough": "prune.rough"},
    "check": {"check.accepted": "untie.rough"},
}
#: What has nothing to go on once another stage is gone, and goes with it.
WITH = {"medial": ("ridge",)}


def without(stage: str) -> str:
    """Return the path of the default configuration without `stage`.

    Raises
    ------
    ValueError
        If the stage cannot be left out.
    """
    if stage not in PASSED:
        raise ValueError(f"one of {sorted(PASSED)} can be left out, got {stage!r}")
    return _written(stage)


@cache
def _written(stage: str) -> str:
    shipped = files("mdcs_pipeline.configs") / "default.yaml"
    document = yaml.safe_load(shipped.read_text(encoding="utf-8"))
    for gone in (stage, *WITH.get(stage, ())):
        del document["stages"][gone]
    for name, held in document["stages"].items():
        held["inputs"] = {port: PASSED[stage].get(at, at) for port, at in held["inputs"].items()}
        _drop_feedback(held, stage)
        if stage == "medial" and name in ("transport", "smooth"):
            held["settings"]["carried"] = "surface"
    path = Path(mkdtemp()) / f"without-{stage}.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return str(path)


def _drop_feedback(held: dict[str, Any], stage: str) -> None:
    """Take out what the stage sent back."""
    ports = {
        port: [way for way in ways if not way["from"].startswith(f"{stage}.")]
        for port, ways in held.pop("feedback", {}).items()
    }
    if kept := {port: ways for port, ways in ports.items() if ways}:
        held["feedback"] = kept
