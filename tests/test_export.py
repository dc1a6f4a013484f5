"""``mdcs export dora``: what it writes, and what it refuses; no dora needed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from mdcs_pipeline.cli.app import app

CUT = """
sources: {cloud: {}}
stages:
  downsample: {inputs: {cloud: sources.cloud}}
  density: {inputs: {cloud: downsample.cloud}}
  seed: {host: solver, inputs: {cloud: density.cloud}}
  transport: {host: solver, inputs: {cloud: density.cloud, nodes: seed.nodes}}
  merge: {inputs: {plan: transport.plan}}
  link: {inputs: {cloud: density.cloud, plan: merge.plan}}
  smooth: {inputs: {cloud: density.cloud, rough: link.rough, points: sources.cloud}}
results: {skeleton: smooth.skeleton}
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "cut.yaml"
    path.write_text(CUT)
    return path


def exported(config: Path, *arguments: str) -> dict[str, Any]:
    done = CliRunner().invoke(app, ["export", "dora", str(config), *arguments])
    assert done.exit_code == 0, done.output
    return {node["id"]: node for node in yaml.safe_load(done.stdout)["nodes"]}


def test_each_host_is_a_node(config: Path, tmp_path: Path) -> None:
    nodes = exported(
        config, "--frames", str(tmp_path), "--results", "out", "--set", "seed.seed=3",
        "--machine", "solver=B", "--program", "mdcs-dora", "--in-flight", "2",
    )  # fmt: skip
    assert list(nodes) == ["frames", "main", "solver", "results"]
    main, solver = nodes["main"], nodes["solver"]
    assert main["path"] == "mdcs-dora"
    assert main["args"] == (
        f"part {config} --host main --set seed.seed=3 --in-flight 2 --waiting 16 --acknowledged"
    )
    assert solver["deploy"] == {"machine": "B"} and "deploy" not in main
    assert set(main["outputs"]) == {"turn", "next", "skeleton", "density.cloud"}
    assert set(main["inputs"]) == {"sources.cloud", "turn_solver", "transport.plan", "written"}
    assert solver["outputs"] == ["turn", "transport.plan"]
    assert set(solver["inputs"]) == {"turn_main", "density.cloud"}
    assert {node["restart_policy"] for node in (main, solver)} == {"on-failure"}
    assert nodes["results"]["args"] == f"write {Path('out').absolute()}"
    outputs = {f"{n}/{o}" for n, node in nodes.items() for o in node.get("outputs", ())}
    wired = {i["source"] for node in nodes.values() for i in node.get("inputs", {}).values()}
    assert wired <= outputs


def test_a_graph_on_one_host_is_one_node(tmp_path: Path) -> None:
    nodes = exported(Path("default"), "--cloud", "camera/points")
    (main,) = nodes.values()
    assert main["inputs"]["sources.cloud"]["source"] == "camera/points"
    assert main["outputs"] == ["next", "skeleton"]
    assert main["args"].startswith("part default ")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ([], "nothing gives clouds to the source 'cloud'"),
        (["--frames", "/no/such"], "no such file or folder"),
        (["--cloud", "points"], "must be written NODE/OUTPUT"),
        (["--cloud", "clod=camera/points"], "did you mean 'cloud'"),
        (["--cloud", "a/b", "--frames", "."], "no other clouds"),
        (["--cloud", "a/b", "--machine", "solvr=B"], "did you mean 'solver'"),
        (["--cloud", "a/b", "--machine", "B"], "must be written HOST=MACHINE"),
        (["--cloud", "a/b", "-o", "flow.txt"], "no format has the suffix '.txt'"),
    ],
)
def test_what_does_not_fit_is_refused(config: Path, arguments: list[str], told: str) -> None:
    done = CliRunner().invoke(app, ["export", "dora", str(config), *arguments])
    assert done.exit_code == 2
    assert told in done.output


@pytest.mark.parametrize("name", ["frames", "results"])
def test_hosts_may_not_take_the_names_of_helpers(tmp_path: Path, name: str) -> None:
    path = tmp_path / "cut.yaml"
    path.write_text(CUT.replace("solver", name))
    done = CliRunner().invoke(app, ["export", "dora", str(path), "--cloud", "a/b"])
    assert done.exit_code == 2 and f"cannot be called '{name}'" in done.output


def test_hosts_have_names_that_other_runtimes_can_bear(tmp_path: Path) -> None:
    path = tmp_path / "cut.yaml"
    path.write_text(CUT.replace("host: solver", "host: far-away", 1))
    done = CliRunner().invoke(app, ["validate", str(path)])
    assert done.exit_code == 2 and "cannot be the host" in done.output
