"""The command line as a shell sees it: real processes, their codes, streams and files."""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mdcs_pipeline.cli import main
from mdcs_pipeline.cli.compiling import NOTICE
from mdcs_pipeline.demo import demo_cloud
from mdcs_pipeline.skeleton import Skeleton

COMMAND = [sys.executable, "-m", "mdcs_pipeline"]


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clouds") / "cloud.npy"
    np.save(path, demo_cloud(1500))
    return path


def mdcs(
    *args: object, env: dict[str, str] | None = None, cwd: Path | None = None
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, *map(str, args)],
        capture_output=True,
        text=True,
        timeout=120,
        stdin=subprocess.DEVNULL,
        env={**os.environ, **(env or {})},
        cwd=cwd,
        check=False,
    )


def left_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


# --- what works


def test_a_run_writes_every_output_and_says_what_came_of_it(cloud: Path, tmp_path: Path) -> None:
    files = [tmp_path / f"s{suffix}" for suffix in (".json", ".npz")]
    outputs = [word for file in files for word in ("-o", file)]
    more = ["--frame-id", "map", "--stamp-ns", 12, "--set", "transport.epsilon=1.7"]
    done = mdcs("run", "default", "-i", cloud, *outputs, *more)
    assert done.returncode == 0, done.stderr
    skeleton = Skeleton.load(files[0])
    assert (skeleton.header.frame_id, skeleton.header.stamp_ns) == ("map", 12)
    assert json.loads(files[0].read_text())["settings"]["transport"]["epsilon"] == 1.7
    np.testing.assert_array_equal(Skeleton.load(files[1]).nodes, skeleton.nodes)
    told = dict(line.split(maxsplit=1) for line in done.stdout.splitlines()[:9])
    counts = {name: str(value) for name, value in skeleton.summary().items()}
    assert counts.items() <= {k: v.strip() for k, v in told.items()}.items()
    assert all(f"written     {file}" in done.stdout for file in files)
    assert "transport round 2, " in done.stderr
    assert " nodes, ε 1.7, " in done.stderr
    assert left_in(tmp_path) == ["s.json", "s.npz"]


def test_json_is_one_object_and_quiet_is_silent(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "s.json"
    done = mdcs("run", "default", "-i", cloud, "-o", out, "--json", "--quiet", "--profile")
    report = json.loads(done.stdout)
    assert done.stderr == ""
    assert report["ok"] is True
    assert report["topology"] == Skeleton.load(out).summary()
    assert report["outputs"] == [str(out)]
    assert report["inputs"] == {"cloud": str(cloud)}
    assert (report["points"], report["dropped"]) == (len(np.load(cloud)), 0)
    assert report["rounds"]["merge.unsettled -> transport.nodes"] >= 1
    shares = [row["share"] for row in report["profile"].values()]
    assert sum(shares) == pytest.approx(1.0, abs=0.01)
    assert report["profile"]["transport"]["firings"] == report["firings"]["transport"]
    assert sum(report["seconds"]["stages"].values()) < report["seconds"]["total"]


def test_a_folder_is_a_sequence_of_frames(tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    for number in (10, 2):
        np.save(frames / f"f_{number}.npy", demo_cloud(1000, seed=number))
    np.savez(frames / "f_2.npz", points=demo_cloud(1000, seed=3))
    (frames / "notes.txt").write_text("no cloud")
    out = tmp_path / "out"
    done = mdcs("run", "default", "-i", frames, "-o", out, "--json", "-q")
    assert done.returncode == 0, done.stdout
    report = json.loads(done.stdout)
    assert [f["frame"] for f in report["frames"]] == ["f_2.npy", "f_2.npz", "f_10.npy"]
    assert [f["header"]["seq"] for f in report["frames"]] == [0, 1, 2]
    # Two frames share a stem: neither may overwrite the other.
    assert left_in(out) == ["f_10.json", "f_2.npy.json", "f_2.npz.json"]
    assert all(len(Skeleton.load(out / name)) for name in left_in(out))


def test_the_demo_writes_cloud_skeleton_and_picture(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    done = mdcs("demo", "-o", tmp_path / "new" / "demo")
    assert done.returncode == 0, done.stderr
    assert left_in(tmp_path / "new" / "demo") == ["cloud.npy", "skeleton.json", "skeleton.png"]
    assert Skeleton.load(tmp_path / "new" / "demo" / "skeleton.json").summary()["leaves"] == 6
    assert (tmp_path / "new/demo/skeleton.png").read_bytes().startswith(b"\x89PNG")
    assert "leaves" in done.stdout


def test_without_an_output_it_says_that_nothing_is_written(cloud: Path, tmp_path: Path) -> None:
    told = mdcs("run", "-i", cloud, cwd=tmp_path)
    assert told.returncode == 0, told.stderr
    assert "nothing written" in told.stderr.splitlines()[-1]
    assert left_in(tmp_path) == []
    assert "nothing written" not in mdcs("run", "-i", cloud, "--json").stderr


# --- what is refused


def _damaged(folder: Path, cloud: Path) -> None:
    (folder / "empty.npy").write_bytes(b"")
    (folder / "cut.npy").write_bytes(cloud.read_bytes()[:5000])
    np.save(folder / "nan.npy", np.full((20, 3), np.nan))
    np.save(folder / "none.npy", np.empty((0, 3)))
    np.save(folder / "same.npy", np.ones((200, 3)))
    np.save(folder / "flat.npy", np.ones((20, 2)))
    (folder / "cloud.las").write_bytes(b"LASF")
    (folder / "bad.yaml").write_text("stages: [1, 2]\n")
    (folder / "loop.yaml").write_text("a: &a [*a]\n")
    (folder / "folder.json").mkdir()
    (folder / "nothing").mkdir()


# Each in a process of its own.
IN_A_SHELL: list[tuple[list[str], list[str]]] = [
    (["default", "-i", "missing.npy"], ["missing.npy", "no such file"]),
    (["default", "-i", "empty.npy"], ["empty.npy", "the file is empty"]),
    (["default", "-i", "cut.npy"], ["cut.npy", "damaged"]),
    (["default", "-i", "nan.npy"], ["nan.npy", "all points hold NaN"]),
    (["default", "-i", "CLOUD", "-o", "s.jsn"], ["s.jsn", "did you mean '.json'"]),
    (["default", "-i", "CLOUD", "-o", "no/s.json"], ["there is no folder no"]),
    (["default", "-i", "CLOUD", "-o", "/proc/s.json"], ["/proc/s.json"]),
    (["defalt", "-i", "CLOUD"], ["unknown configuration 'defalt'", "'default'"]),
    (["bad.yaml", "-i", "CLOUD"], ["bad.yaml:1", "stages"]),
    (["default", "-i", "CLOUD", "--set", "mrege.rule=x"], ["did you mean 'merge'"]),
    (["default", "-i", "CLOUD", "--set", "merge.rul=x"], ["did you mean 'rule'"]),
    (["default", "-i", "CLOUD", "--set", "merge"], ["stage.setting=value"]),
]
# In this one, which is quicker.
IN_PROCESS: list[tuple[list[str], list[str]]] = [
    (["default", "-i", "none.npy"], ["none.npy", "no points"]),
    (["default", "-i", "same.npy"], ["all points coincide"]),
    (["default", "-i", "flat.npy"], ["flat.npy", "shape"]),
    (["default", "-i", "cloud.las"], ["cloud.las", "suffix"]),
    (["default", "-i", "nothing"], ["nothing", "no cloud file"]),
    (["default"], ["no cloud was given", "-i FILE"]),
    ([], ["no cloud was given", "-i FILE"]),
    (["none.npy"], ["a cloud stands where", "mdcs run default -i none.npy"]),
    (["default", "-i", "CLOUD", "--port", "0"], ["--port", "add --view"]),
    (["default", "-i", "cluod=CLOUD"], ["'cluod'", "did you mean 'cloud'"]),
    (["default", "-i", "CLOUD", "-i", "CLOUD"], ["'cloud' is given twice"]),
    (["default", "-i", "CLOUD", "-o", "skeleton"], ["the file has no suffix"]),
    (["default", "-i", "CLOUD", "-o", "folder.json"], ["a folder is in the file's place"]),
    (["default", "-i", "CLOUD", "-o", "CLOUD"], ["suffix '.npy'"]),
    (["loop.yaml", "-i", "CLOUD"], ["loop.yaml"]),
    (["no.yaml", "-i", "CLOUD"], ["no.yaml", "cannot be read"]),
    (["default", "-i", "CLOUD", "--set", "merge.rule=x"], ["setting 'rule'"]),
    (["default", "-i", "CLOUD", "--stamp-ns", "soon"], ["--stamp-ns", "mdcs run --help"]),
    (["default", "-i", "CLOUD", "--quite"], ["--quite", "--quiet"]),
    (["default", "-i", "[/red]x.npy"], ["[/red]x.npy"]),
]


def _in_process(args: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main(args)
    held = capsys.readouterr()
    assert isinstance(ended.value.code, int)
    return ended.value.code, held.out, held.err


@pytest.mark.parametrize(
    ("args", "words", "shell"),
    [(*case, True) for case in IN_A_SHELL] + [(*case, False) for case in IN_PROCESS],
)
def test_bad_input_is_one_clear_error_and_no_file(
    args: list[str],
    words: list[str],
    shell: bool,
    cloud: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    _damaged(tmp_path, cloud)
    monkeypatch.chdir(tmp_path)
    before = left_in(tmp_path)
    given = ["run", *(arg.replace("CLOUD", str(cloud)) for arg in args)]
    if "-o" not in given:
        given += ["-o", "s.json"]
    if shell:
        done = mdcs(*given)
        code, out, err = done.returncode, done.stdout, done.stderr
    else:
        code, out, err = _in_process(given, capsys)
    assert code == 2, err
    assert out == ""
    assert err.splitlines()[-1].startswith(("error: ", "  "))
    assert "Traceback" not in err
    assert "internal" not in err
    for word in words:
        assert word in err
    assert left_in(tmp_path) == before
    # An output is refused before the work: no stage has fired.
    if "-o" in args:
        assert "round" not in err


def test_errors_are_json_for_machines(cloud: Path, tmp_path: Path) -> None:
    for args in (["-i", tmp_path / "x.npy"], ["-i", cloud, "--nonsense"]):
        done = mdcs("run", "default", *args, "--json")
        fault = json.loads(done.stdout)
        assert (done.returncode, fault["exit_code"], fault["ok"]) == (2, 2, False)
        assert fault["error"]["what"]
        assert "Traceback" not in done.stderr


def test_an_output_that_fails_at_the_end_leaves_nothing(tmp_path: Path) -> None:
    """A loop cannot be SWC, which shows only once there is a skeleton."""
    turn = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    around, up = np.repeat(ring, 16, axis=0), np.tile(turn[:16] * 60 / 16, 60)
    torus = np.column_stack([around * (1 + 0.2 * np.cos(up))[:, None], 0.2 * np.sin(up)])
    np.save(tmp_path / "torus.npy", torus)
    done = mdcs("run", "default", "-i", tmp_path / "torus.npy", "-o", tmp_path / "s.swc", "-q")
    assert done.returncode == 2
    assert "s.swc" in done.stderr
    assert left_in(tmp_path) == ["torus.npy"]


# --- how it ends


def test_ctrl_c_ends_it_cleanly(tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    points = demo_cloud(1000)
    for number in range(60):
        np.save(frames / f"f{number}.npy", points)
    words = ["run", "default", "-i", str(frames), "-o", str(tmp_path / "out")]
    running = subprocess.Popen(
        [*COMMAND, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert running.stderr is not None
    first = running.stderr.readline()
    while "round" not in first:
        first = running.stderr.readline()
    running.send_signal(signal.SIGINT)
    out, told = running.communicate(timeout=60)
    assert running.returncode == 130
    assert out == ""
    assert told.rstrip().endswith("interrupted")
    assert "Traceback" not in told
    written = left_in(tmp_path / "out") if (tmp_path / "out").exists() else []
    assert len(written) < 60
    # What was finished is whole, and nothing else is there.
    assert all(len(Skeleton.load(tmp_path / "out" / name)) for name in written)


def test_ctrl_c_within_a_run_leaves_no_file(tmp_path: Path) -> None:
    points = np.repeat(demo_cloud(2000), 12, axis=0)
    points += np.random.default_rng(0).normal(0.0, 0.01, points.shape)
    np.save(tmp_path / "big.npy", points)
    words = ["run", "default", "-i", str(tmp_path / "big.npy"), "-o", str(tmp_path / "s.json")]
    running = subprocess.Popen(
        [*COMMAND, *words, "--set", "downsample.voxel=0.002"], stderr=subprocess.PIPE, text=True
    )
    assert running.stderr is not None
    while "density round" not in running.stderr.readline():
        pass
    running.send_signal(signal.SIGINT)
    _, told = running.communicate(timeout=60)
    assert running.returncode == 130
    assert "Traceback" not in told
    assert left_in(tmp_path) == ["big.npy"]


def test_a_reader_that_goes_is_no_failure() -> None:
    for words in (["options", "transport"], ["graph", "default"]):
        running = subprocess.Popen(
            [*COMMAND, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert running.stdout is not None
        running.stdout.close()
        assert running.stderr is not None
        told = running.stderr.read()
        assert running.wait(60) == 0
        assert told == ""


ASCII = {"LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


def test_a_progress_that_nobody_reads_does_not_stop_the_run(cloud: Path, tmp_path: Path) -> None:
    """Standard error closed early: rich ends the process then, and the result was lost."""
    out = tmp_path / "s.json"
    running = subprocess.Popen(
        [*COMMAND, "run", "default", "-i", str(cloud), "-o", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    assert running.stderr is not None
    running.stderr.close()
    assert running.wait(timeout=60) == 0
    assert len(Skeleton.load(out))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("words", [["--version"], ["schema"], ["run", "default", "--json"]])
def test_a_full_disk_behind_standard_output_is_one_line(words: list[str]) -> None:
    """The fault of --json could not be told on standard output and left a traceback."""
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*COMMAND, *words], stdout=full, stderr=subprocess.PIPE, text=True, timeout=60
        )
    assert done.returncode in (1, 2)
    assert "error: " in done.stderr
    assert "Traceback" not in done.stderr


def test_an_ascii_terminal_gets_letters_spelt_out(cloud: Path) -> None:
    done = mdcs("run", "default", "-i", cloud, env=ASCII)
    assert done.returncode == 0
    assert re.search(r"eps \d", done.stderr)
    assert "ε" not in done.stderr
    done = mdcs("options", "transport", env=ASCII)
    assert "eps of Eq. 4" in done.stdout
    assert "> 0, <= 1" in done.stdout
    assert "thickness? -> plan" in done.stdout
    assert mdcs("--help", env=ASCII).returncode == 0


def test_no_colour_codes_in_a_pipe_or_where_none_are_wanted() -> None:
    for env in ({}, {"NO_COLOR": "1", "TERM": "xterm"}):
        done = mdcs("stages", env=env)
        assert done.returncode == 0
        assert "\x1b" not in done.stdout


@pytest.mark.parametrize(("term", "drawn"), [("xterm", True), ("dumb", False)])
def test_on_a_terminal_one_line_is_drawn_anew(cloud: Path, term: str, drawn: bool) -> None:
    outer, inner = pty.openpty()
    env = {**os.environ, "TERM": term, "COLUMNS": "120", "NO_COLOR": "1"}
    running = subprocess.Popen(
        [*COMMAND, "run", "default", "-i", str(cloud)],
        stdout=subprocess.PIPE,
        stderr=inner,
        env=env,
    )
    os.close(inner)
    told = b""
    try:
        while chunk := os.read(outer, 65536):
            told += chunk
    except OSError:  # The terminal is gone once the process is.
        pass
    os.close(outer)
    out, _ = running.communicate(timeout=60)
    assert running.returncode == 0
    assert b"leaves" in out
    assert b"\x1b" not in out
    text = told.decode()
    assert ("\x1b[2K" in text) is drawn
    assert "round" in text


# --- what it costs


HEAVY = ("numba", "scipy", "numpy", "networkx", "open3d", "matplotlib", "yaml", "k3d")


@pytest.mark.parametrize(
    ("words", "heavy"),
    [
        (["--help"], (*HEAVY, "pydantic")),
        # Later versions of typer load pydantic themselves to read the options of a command.
        (["run", "--help"], HEAVY),
        (["--version"], HEAVY),
    ],
)
def test_help_loads_nothing_heavy(words: list[str], heavy: tuple[str, ...]) -> None:
    code = f"""
import sys
from mdcs_pipeline.cli import main
try:
    main({words!r})
except SystemExit as end:
    assert end.code == 0, end.code
print("loaded", sorted(set({heavy!r}) & set(sys.modules)))
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stdout.splitlines()[-1] == "loaded []", done.stderr


def test_the_first_run_says_that_it_compiles(cloud: Path) -> None:
    code = (
        "import mdcs_pipeline.cli.run as run; run.kernels_cached = lambda: False;"
        f"from mdcs_pipeline.cli import main; main(['run', 'default', '-i', {str(cloud)!r}])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.stderr.splitlines()[0] == NOTICE
    assert done.stderr.count(NOTICE) == 1
