"""``mdcs stream --view`` within this process, over a server without sockets."""

from __future__ import annotations

import io
import json
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import frames
import numpy as np
import pytest
from fake_viser import closed_at_once, shown
from typer.testing import CliRunner

from mdcs_pipeline.cli.app import app
from mdcs_pipeline.skeleton import Skeleton
from mdcs_pipeline.viewer.page import LivePage

SET = ["--set", f"scene.voxel_size={frames.VOXEL}"]


def mdcs(*args: object) -> Any:
    return CliRunner().invoke(app, ["stream", "streaming", *SET, *map(str, args)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("frames")
    for k, cloud in enumerate(frames.orbit(4)):
        np.save(made / f"frame_{k}.npy", cloud)
    # A cloud of no use in between: counted, told of, not shown.
    np.save(made / "frame_1b.npy", np.full((10, 3), np.nan))
    return made


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> list[LivePage]:
    return closed_at_once(monkeypatch)


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    words: list[str] = []
    monkeypatch.setattr(LivePage, "say", lambda page, text, hurry=False: words.append(text))
    return words


def press(page: LivePage, name: str) -> None:
    page._server.gui.by_label[name].by_user()


def test_every_frame_is_shown_and_can_be_made_again(
    folder: Path, tmp_path: Path, seen: list[LivePage], said: list[str]
) -> None:
    out = tmp_path / "s.json"
    done = mdcs("-i", folder, "-o", out, "--view", "--json")
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["frames"]["used"] == 4
    held = shown(seen[0])
    assert [frame.label for frame in held[:4]] == ["cloud 1", "cloud 2", "cloud 4", "cloud 5"]
    assert "cloud 3 dropped: the frame is empty" in "\n".join(said).replace("\\", "")
    # The map grows as the eye goes round, and what is seen last is what was written.
    assert len(held[0].points) < len(held[3].points)
    final = Skeleton.load(out)
    np.testing.assert_array_equal(held[-1].skeleton.nodes, final.nodes)
    for frame in held:
        assert set(frame.skeleton.diagnostics["seconds"]) >= {"scene", "transport", "splice"}
        assert frame.settings["scene"]["voxel_size"] == frames.VOXEL
    # With its own ε a frame comes out as it was: the stream is run anew up to it.
    usual = held[2].settings["transport"]["epsilon"]
    for frame in (held[2], held[-1]):
        np.testing.assert_array_equal(frame.again(usual).skeleton.nodes, frame.skeleton.nodes)
    coarse = held[-1].again(3 * usual)
    assert len(coarse.skeleton) < len(final)
    assert coarse.points is None
    assert coarse.settings["transport"]["epsilon"] == 3 * usual
    assert "running anew, frame 4 …" in said
    assert seen[0]._server.stopped


class Pauser:
    """A user who presses Pause once `after` frames are shown, and Play on demand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, after: int) -> None:
        self.paused = threading.Event()
        show = LivePage.show

        def showing(page: LivePage, frame: Any, **more: Any) -> None:
            show(page, frame, **more)
            if len(page._film) == after:
                press(page, "Pause")
                self.page = page
                self.paused.set()

        monkeypatch.setattr(LivePage, "show", showing)


def in_thread(call: Callable[[], Any]) -> tuple[threading.Thread, SimpleNamespace]:
    given = SimpleNamespace()
    thread = threading.Thread(target=lambda: setattr(given, "result", call()))
    thread.start()
    return thread, given


def test_a_pause_holds_a_folder_up(
    folder: Path, seen: list[LivePage], said: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    user = Pauser(monkeypatch, after=2)
    thread, given = in_thread(lambda: mdcs("-i", folder, "--view", "--json"))
    assert user.paused.wait(120)
    # Two frames and no more, for as long as it stands; a second is an age for this stream.
    thread.join(1.0)
    assert thread.is_alive()
    assert len(user.page._film) == 2
    assert said[-1] == "paused: no more frames are read until it plays"
    press(user.page, "Pause")
    thread.join(120)
    assert given.result.exit_code == 0, given.result.stderr
    held = json.loads(given.result.stdout)
    assert held["frames"]["used"] == 4
    assert len(shown(seen[0])) >= 4


def test_a_pause_holds_no_pipe_up(
    folder: Path, seen: list[LivePage], said: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    data = b"".join((folder / f"frame_{k}.npy").read_bytes() for k in range(4))
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(data)))
    user = Pauser(monkeypatch, after=2)
    cursors: list[int] = []
    finish = LivePage.finish
    monkeypatch.setattr(
        LivePage, "finish", lambda page: (cursors.append(page._film.cursor), finish(page))
    )
    monkeypatch.setattr(CliRunner, "invoke", invoke_here)
    assert mdcs("-i", "-", "--view", "-q") == 0
    assert user.paused.is_set()
    # Four frames came and were kept; the picture is that of the second.
    assert len(shown(seen[0])) >= 4
    assert cursors == [1]
    assert any("the stream goes on" in text for text in said)
    # What went through a pipe cannot be read again.
    assert all(frame.again is None for frame in shown(seen[0]))


def invoke_here(_: CliRunner, __: Any, words: list[str]) -> Any:
    """Run a command on this process's own standard input, which the runner would replace."""
    from mdcs_pipeline.cli import main

    with pytest.raises(SystemExit) as ended, pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["mdcs", *words])
        raise SystemExit(main())
    return ended.value.code or 0


def test_a_stream_that_goes_on_from_a_checkpoint_offers_no_dial(
    folder: Path, tmp_path: Path, seen: list[LivePage]
) -> None:
    half = tmp_path / "half"
    half.mkdir()
    for k in range(2):
        (half / f"frame_{k}.npy").write_bytes((folder / f"frame_{k}.npy").read_bytes())
    words = ["--checkpoint", tmp_path / "scene.ckpt", "--every", "1", "-q"]
    assert mdcs("-i", half, *words).exit_code == 0
    (half / "frame_2.npy").write_bytes((folder / "frame_2.npy").read_bytes())
    done = mdcs("-i", half, *words, "--view")
    assert done.exit_code == 0, done.stderr
    held = shown(seen[0])
    assert held[0].label == "cloud 3"
    assert all(frame.again is None for frame in held)


def test_an_address_without_a_page_is_refused(folder: Path) -> None:
    done = mdcs("-i", folder, "--port", "0")
    assert done.exit_code == 2
    assert "--view" in done.stderr
