"""Every command and its parts, within this process."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from typer.testing import CliRunner

from mdcs_pipeline.cli.app import app
from mdcs_pipeline.cli.guard import Mode, guarded
from mdcs_pipeline.cli.inputs import by_source
from mdcs_pipeline.cli.options import range_text, type_text
from mdcs_pipeline.cli.progress import Bar, Lines, Reporter, reporter
from mdcs_pipeline.config import config_names
from mdcs_pipeline.demo import demo_cloud
from mdcs_pipeline.errors import InputError, StageError
from mdcs_pipeline.skeleton import Skeleton
from mdcs_pipeline.stage import stage_class, stage_names

ROOT = Path(__file__).parent.parent
TWO = """
sources: {left: , right: }
stages:
  combine: {inputs: {clouds: [sources.left, sources.right]}}
  density: {inputs: {cloud: combine.cloud}}
  seed: {inputs: {cloud: density.cloud}}
  transport: {inputs: {cloud: density.cloud, nodes: seed.nodes}, settings: {max_steps: 1}}
  link: {inputs: {cloud: density.cloud, plan: transport.plan}}
  smooth: {inputs: {cloud: density.cloud, rough: link.rough}, settings: {SMOOTH}}
results: {skeleton: smooth.skeleton}
""".replace("{SMOOTH}", "{}")


def mdcs(*args: object) -> Any:
    return CliRunner().invoke(app, [str(arg) for arg in args])


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clouds") / "cloud.npy"
    np.save(path, demo_cloud(1000))
    return path


# --- what there is


def test_every_stage_is_listed_with_its_ports() -> None:
    done = mdcs("stages")
    assert done.exit_code == 0
    starts = {line.split()[0] for line in done.stdout.splitlines() if line[:1].strip()}
    assert set(stage_names()) <= starts
    assert "cloud, nodes, thickness? → plan" in done.stdout
    assert "clouds* → cloud" in done.stdout


@pytest.mark.parametrize("name", stage_names())
def test_every_setting_is_explained(name: str) -> None:
    done = mdcs("options", name)
    assert done.exit_code == 0, done.stderr
    fields = stage_class(name).Settings.model_fields
    assert ("no settings" in done.stdout) is (not fields)
    for setting, info in fields.items():
        assert f"\n{setting} " in done.stdout
        assert (info.description or "?").split()[0] in done.stdout


def test_types_and_ranges_are_written_as_people_write_them() -> None:
    assert type_text(float | None) == "float or None"
    assert type_text(Literal["a", "b"]) == "one of a, b"
    assert type_text(tuple[int, ...]) == "tuple[int, …]"
    fields = stage_class("transport").Settings.model_fields
    assert range_text(fields["theta"]) == "> 0, ≤ 1"
    assert range_text(fields["marginals"]) == ""


def test_unknown_names_get_the_nearest_one() -> None:
    for words, near in (
        (["options", "trnsport"], "transport"),
        (["validate", "defualt"], "default"),
        (["rnu"], "run"),
    ):
        done = mdcs(*words)
        assert done.exit_code == 2
        assert f"'{near}'" in done.stderr


def test_who_names_no_stage_is_told_the_names() -> None:
    done = mdcs("options")
    assert done.exit_code == 2
    assert "one of: bridge, check" in done.stderr


def test_configurations_are_listed_and_valid() -> None:
    listed = mdcs("configs").stdout
    for name in config_names():
        assert f"\n{name} " in listed
        done = mdcs("validate", name)
        assert done.exit_code == 0
        assert f"{name}.yaml: valid: 1 source, " in done.stdout
    assert mdcs("validate", "default", "--set", "transport.theta=0.7").exit_code == 0
    assert mdcs("validate", "default", "--set", "transport.theta=7").exit_code == 2


def test_version_and_no_command() -> None:
    done = mdcs("--version")
    assert (done.exit_code, done.stdout.split()[0]) == (0, "mdcs-pipeline")
    done = mdcs()
    assert done.exit_code == 2
    assert "Usage: " in done.stdout


def test_graph_as_text_and_as_files(tmp_path: Path) -> None:
    text = mdcs("graph", "default").stdout
    assert text.startswith("flowchart TD")
    assert mdcs("graph", "default", "-o", tmp_path / "g.mmd").exit_code == 0
    assert (tmp_path / "g.mmd").read_text(encoding="utf-8") == text
    pytest.importorskip("matplotlib")
    for suffix, start in ((".svg", b"<?xml"), (".png", b"\x89PNG")):
        assert mdcs("graph", "paper", "-o", tmp_path / f"g{suffix}").exit_code == 0
        assert (tmp_path / f"g{suffix}").read_bytes().startswith(start)
    done = mdcs("graph", "default", "-o", tmp_path / "g.svgz")
    assert done.exit_code == 2
    assert "did you mean '.svg'" in done.stderr


def test_schema_on_standard_output_and_in_a_file(tmp_path: Path) -> None:
    held = json.loads(mdcs("schema").stdout)
    assert "transport.settings" in held["$defs"]
    assert mdcs("schema", "-o", tmp_path / "s.json").exit_code == 0
    assert json.loads((tmp_path / "s.json").read_text()) == held


def test_a_file_that_cannot_be_written_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    done = mdcs("schema", "-o", tmp_path / "s.json")
    assert done.exit_code == 2
    assert "No space left" in done.stderr
    assert not list(tmp_path.iterdir())


# --- runs


def test_a_profile_accounts_for_all_of_the_time(cloud: Path) -> None:
    done = mdcs("run", "default", "-i", cloud, "--profile")
    assert done.exit_code == 0, done.stderr
    stages, _, rounds = done.stdout.partition("slowest round")[2].partition("\n\n")
    rows = stages.splitlines()[1:]
    total = next(float(row.split()[1]) for row in rows if row.startswith("total"))
    parts = {row.split()[0]: row.split() for row in rows if not row.startswith("total")}
    spent = sum(float(p[1 if name == "outside" else 2]) for name, p in parts.items())
    assert spent == pytest.approx(total, abs=0.02)
    assert int(parts["transport"][1]) > 1
    names, *each = [line.split() for line in rounds.splitlines()]
    column = names.index("transport")
    assert len(each) == int(parts["transport"][1])
    assert sum(float(row[column]) for row in each) == pytest.approx(
        float(parts["transport"][2]), abs=0.02
    )


def test_several_sources_go_by_name(cloud: Path, tmp_path: Path) -> None:
    config = tmp_path / "two.yaml"
    config.write_text(TWO)
    out = tmp_path / "s.json"
    done = mdcs("run", config, "-i", f"left={cloud}", "-i", f"right={cloud}", "-o", out, "-q")
    assert done.exit_code == 0, done.stderr
    assert len(Skeleton.load(out))
    for inputs, words in (
        ([f"left={cloud}"], "nothing was given for the source 'right'"),
        ([f"{cloud}"], "-i left=FILE -i right=FILE"),
        ([f"left={cloud}", f"rihgt={cloud}"], "did you mean 'right'"),
        ([f"left={cloud}", f"right={tmp_path}"], "one source only"),
    ):
        done = mdcs("run", config, *(word for i in inputs for word in ("-i", i)))
        assert done.exit_code == 2
        assert words in done.stderr


def test_a_file_whose_name_has_an_equals_sign_is_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert by_source(["cloud=a.npy"], ["cloud"]) == {"cloud": Path("a.npy")}
    Path("cloud=a.npy").touch()
    assert by_source(["cloud=a.npy"], ["cloud"]) == {"cloud": Path("cloud=a.npy")}
    assert by_source(["x/cloud=a.npy"], ["cloud"]) == {"cloud": Path("x/cloud=a.npy")}
    with pytest.raises(InputError, match="has 0 sources"):
        by_source(["a.npy"], [])


def test_a_pipeline_that_reads_and_writes_by_itself(cloud: Path, tmp_path: Path) -> None:
    config = tmp_path / "own.yaml"
    config.write_text(
        f"stages:\n  read: {{settings: {{path: {cloud}}}}}\n"
        "  downsample: {inputs: {cloud: read.cloud}}\nresults: {cloud: downsample.cloud}\n"
    )
    done = mdcs("run", config, "--json", "-q")
    assert done.exit_code == 0, done.stdout
    assert json.loads(done.stdout)["topology"] is None
    done = mdcs("run", config, "-o", tmp_path / "s.json")
    assert done.exit_code == 2
    assert "gives no skeleton" in done.stderr


def test_a_table_of_frames(tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    for number in (1, 2):
        np.save(frames / f"f{number}.npy", demo_cloud(800))
    done = mdcs("run", "default", "-i", frames, "-o", tmp_path / "o", "--format", ".PLY")
    assert done.exit_code == 0, done.stderr
    assert [line.split()[0] for line in done.stdout.splitlines()[:3]] == [
        "frame",
        "f1.npy",
        "f2.npy",
    ]
    assert "f2.npy: merge round 1" in done.stderr
    assert sorted(p.name for p in (tmp_path / "o").iterdir()) == ["f1.ply", "f2.ply"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["-o", "file"], "a folder must come out"),
        (["-o", "no/way"], "there is no folder no"),
        (["-o", "out", "--format", "jso"], "did you mean '.json'"),
        (["-o", "out", "-o", "./out"], "the same output twice"),
        (["-o", "frames", "--format", "ply"], "overwrite the input"),
    ],
)
def test_what_a_folder_cannot_become(
    words: list[str], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("frames").mkdir()
    Path("frames/a.ply").write_text("ply\n")
    Path("file").touch()
    done = mdcs("run", "default", "-i", "frames", *words)
    assert done.exit_code == 2
    assert told in done.stderr
    assert not Path("out").exists()


def test_a_missing_extra_is_told_before_the_work(
    cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outputs = importlib.import_module("mdcs_pipeline.cli.outputs")
    monkeypatch.setattr(outputs, "find_spec", lambda name: None)
    done = mdcs("run", "default", "-i", cloud, "-o", tmp_path / "s.png")
    assert done.exit_code == 2
    assert "mdcs-pipeline[draw]" in done.stderr
    assert "round" not in done.stderr
    # The demo does without its picture.
    done = mdcs("demo", "-o", tmp_path / "d")
    assert done.exit_code == 0
    assert "no picture" in done.stderr
    assert sorted(p.name for p in (tmp_path / "d").iterdir()) == ["cloud.npy", "skeleton.json"]


def test_the_demo_needs_a_folder(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = mdcs("demo", "-o", tmp_path / "file")
    assert done.exit_code == 2
    assert "the folder cannot be made" in done.stderr


# --- compiling


def test_warmup_says_how_long_it_took(monkeypatch: pytest.MonkeyPatch) -> None:
    pipeline = importlib.import_module("mdcs_pipeline.pipeline")
    made: list[tuple[str, Any]] = []
    monkeypatch.setattr(pipeline, "skeletonize", lambda p, c: made.append((c, p.dtype.name)))
    done = mdcs("warmup")
    assert done.exit_code == 0
    assert done.stdout.startswith("kernels ")
    assert made == [(c, kind) for c in config_names() for kind in ("float64", "float32")]
    assert mdcs("warmup", "-q").stdout == ""


# --- faults


def fails(error: BaseException) -> Any:
    def body() -> None:
        raise error

    return body


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (InputError("bad", remedy="mend it"), 2, "error: bad\n  remedy: mend it\n"),
        (StageError("broke"), 1, "error: broke\n"),
        (KeyboardInterrupt(), 130, "interrupted\n"),
        (
            ZeroDivisionError("by\nzero"),
            1,
            "internal error: ZeroDivisionError: by zero (run with --debug for the traceback)\n",
        ),
        (
            MemoryError(),
            1,
            "internal error: MemoryError (run with --debug for the traceback)\n",
        ),
    ],
)
def test_faults_are_lines_and_codes(
    error: BaseException, code: int, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert guarded(fails(error), Mode()) == code
    held = capsys.readouterr()
    assert (held.out, held.err) == ("", told)
    assert guarded(fails(error), Mode(json=True)) == code
    held = capsys.readouterr()
    assert json.loads(held.out)["exit_code"] == code
    assert held.err == ""


def test_debug_shows_the_traceback_wherever_it_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    config = importlib.import_module("mdcs_pipeline.config")
    monkeypatch.setattr(config, "config_names", fails(RuntimeError("[bold]oh")))
    done = mdcs("configs")
    assert (done.exit_code, "Traceback" in done.stderr) == (1, False)
    assert "RuntimeError: [bold]oh (run with" in done.stderr
    for words in (["configs", "--debug"], ["--debug", "configs"]):
        done = mdcs(*words)
        assert done.exit_code == 1
        assert "Traceback" in done.stderr
    assert "Traceback" in mdcs("--debug", "validate", "nothing.yaml").stderr


def test_warnings_are_lines(capsys: pytest.CaptureFixture[str]) -> None:
    import warnings

    def body() -> None:
        warnings.simplefilter("always")
        warnings.warn("look out", RuntimeWarning, stacklevel=1)

    assert guarded(body, Mode()) == 0
    assert capsys.readouterr().err == "warning: look out\n"
    assert guarded(body, Mode(quiet=True)) == 0
    assert capsys.readouterr().err == ""


def test_who_watches() -> None:
    assert type(reporter(quiet=True)) is Reporter
    assert type(reporter(quiet=False)) is Lines


def test_the_bar_shows_stage_round_nodes_and_epsilon(cloud: Path) -> None:
    import io

    from rich.console import Console

    from mdcs_pipeline.pipeline import Pipeline

    told = io.StringIO()
    console = Console(file=told, force_terminal=True, width=120, color_system=None)
    with Bar(console) as bar, Pipeline.from_config("default", hooks=(bar,)) as pipe:
        bar.stage_started("merge", 1)
        for label in ("", "f2.npy"):
            bar.frame(label)
            pipe.push(np.load(cloud))
            bar.stage_started("merge", 3)
            assert bar._progress is not None
            bar._progress.refresh()
    text = told.getvalue()
    assert "merge round 3, " in text
    assert re.search(r" nodes, ε \d", text)
    assert "f2.npy, merge round 3" in text


# --- the wheel


def test_the_wheel_holds_every_package_and_its_data(tmp_path: Path) -> None:
    pytest.importorskip("setuptools", minversion="77")
    # Built from a copy: setuptools leaves a folder build/ that a later build would take up.
    copy = tmp_path / "copy"
    copy.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE", "mdcs_pipeline", "nodes", "configs"):
        if not (ROOT / name).exists():
            continue
        subprocess.run(["cp", "-r", str(ROOT / name), str(copy)], check=True)
    for cache in copy.rglob("__pycache__"):
        shutil.rmtree(cache)
    words = ["wheel", "-q", "--no-deps", "--no-build-isolation", "-w", str(tmp_path), str(copy)]
    subprocess.run([sys.executable, "-m", "pip", *words], check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as held:
        names = set(held.namelist())
        points = held.read(next(n for n in names if n.endswith("entry_points.txt"))).decode()
    wanted = {f"mdcs_pipeline/configs/{p.name}" for p in (ROOT / "configs").glob("*.yaml")}
    wanted |= {f"mdcs_pipeline/nodes/{p.name}" for p in (ROOT / "nodes").glob("*.py")}
    package = (ROOT / "mdcs_pipeline").rglob("*.py")
    wanted |= {str(p.relative_to(ROOT)) for p in package} | {"mdcs_pipeline/py.typed"}
    assert wanted <= names, wanted - names
    assert "mdcs = mdcs_pipeline.cli:main" in points
    assert not [n for n in names if n.startswith(("tests/", "benchmarks/")) or "__pycache__" in n]
