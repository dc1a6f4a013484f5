"""A third-party package: installed from its own folder, used from YAML."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = """
[build-system]
requires = ["setuptools"]
build-backend = "setuptools.build_meta"

[project]
name = "halving-stage"
version = "0.1"

[project.entry-points."mdcs_pipeline.stages"]
halve = "halving_stage:Halve"
broken = "halving_stage:Missing"
wrong = "halving_stage:HalveSettings"

[tool.setuptools]
py-modules = ["halving_stage"]
"""

MODULE = '''
from typing import NamedTuple

from pydantic import Field

from mdcs_pipeline.messages import PointCloud
from mdcs_pipeline.stage import Settings, Stage


class HalveSettings(Settings):
    keep: int = Field(2, ge=1, description="Every so many points one is kept.")


class Result(NamedTuple):
    cloud: PointCloud


class Halve(Stage[HalveSettings]):
    """Keep every second point."""

    Settings = HalveSettings

    def __call__(self, cloud: PointCloud) -> Result:
        return Result(PointCloud(cloud.positions[:: self.settings.keep], header=cloud.header))
'''

CONFIG = """
sources: {cloud: }
stages:
  thin:
    stage: halve
    inputs: {cloud: sources.cloud}
    settings: {keep: 3}
  halve: {inputs: {cloud: thin.cloud}}
results: {cloud: halve.cloud}
"""

USE = """
import sys
import numpy as np
from mdcs_pipeline.pipeline import Pipeline
from mdcs_pipeline.stage import stage_class, stage_names

points = np.arange(36.0).reshape(12, 3)
with Pipeline.from_config(sys.argv[1]) as pipe:
    print(pipe.run(cloud=points).results["cloud"].positions[:, 0].tolist())
print("halve" in stage_names(), "read" in stage_names())
for name in ("broken", "wrong", "halv"):
    try:
        stage_class(name)
    except Exception as error:
        print(type(error).__name__, str(error).replace(chr(10), ""))
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("setuptools")
    pytest.importorskip("pip")
    source = tmp_path_factory.mktemp("source")
    (source / "pyproject.toml").write_text(PROJECT)
    (source / "halving_stage.py").write_text(MODULE)
    target = tmp_path_factory.mktemp("target")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--target", str(target)]
    done = subprocess.run(
        [*pip, *options, str(source)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return target


def test_a_stage_of_another_package_is_used_from_yaml(installed: Path, tmp_path: Path) -> None:
    config = tmp_path / "thin.yaml"
    config.write_text(CONFIG)
    script = tmp_path / "use.py"
    script.write_text(USE)
    path = os.pathsep.join(filter(None, [str(installed), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        [sys.executable, str(script), str(config)],
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "PYTHONPATH": path},
    )
    assert done.returncode == 0, done.stderr
    kept, known, broken, wrong, misspelt = done.stdout.splitlines()
    # 12 points: every third is 0, 3, 6, 9; every second of these 0 and 6, at x = 0 and 18.
    assert kept == "[0.0, 18.0]"
    assert known == "True True"
    assert broken.startswith("ConfigError stage 'broken' cannot be loaded")
    assert wrong.startswith("ConfigError stage 'wrong' is no Stage")
    assert "did you mean 'halve'" in misspelt


def test_without_the_package_the_stage_is_unknown(tmp_path: Path) -> None:
    from mdcs_pipeline.config import load_spec
    from mdcs_pipeline.errors import ConfigError
    from mdcs_pipeline.graph import build_graph

    config = tmp_path / "thin.yaml"
    config.write_text(CONFIG)
    with pytest.raises(ConfigError, match="unknown stage 'halve'") as caught:
        build_graph(load_spec(config))
    assert f"{config}:4, stage 'thin'" in str(caught.value)
