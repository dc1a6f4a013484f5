"""The live page as its user meets it: a real process, a real server, a real browser.

Needs the extras viewer and browser, and Chromium from the system: `make test-viewer`.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frames import VOXEL, orbit

from mdcs_pipeline.config import load_spec
from mdcs_pipeline.demo import demo_cloud
from mdcs_pipeline.skeleton import Skeleton

pytest.importorskip("viser")

COMMAND = [sys.executable, "-m", "mdcs_pipeline"]
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
# WebGL without a graphics card.
FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
WAIT = 60_000


class Command:
    """A running ``mdcs`` with a page, done with its work unless it is only `begun`."""

    def __init__(self, *args: object, begun: bool = False) -> None:
        words = [*COMMAND, *map(str, args), "--port", "0"]
        self.process = subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        self.told: list[str] = []
        self._ready = threading.Event()
        self._awaited = "page: " if begun else "the page stays at"
        self._reader = threading.Thread(target=self._read)
        self._reader.start()
        assert self._ready.wait(120), self.told

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.told.append(line)
            if line.startswith(self._awaited):
                self._ready.set()
        self._ready.set()

    @property
    def url(self) -> str:
        return next(m[1] for line in self.told if (m := re.match(r"page: (\S+)", line)))

    def interrupt(self) -> tuple[int, str]:
        """Press Ctrl-C; return the exit code and standard output."""
        self.process.send_signal(signal.SIGINT)
        out, _ = self.process.communicate(timeout=60)
        self._reader.join()
        return self.process.returncode, out


@contextlib.contextmanager
def running(*args: object, begun: bool = False) -> Iterator[Command]:
    command = Command(*args, begun=begun)
    try:
        yield command
    finally:
        command.process.kill()
        command.process.wait()


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("viewer") / "animal.npy"
    np.save(path, demo_cloud(2000))
    return path


# --- the server


def test_the_page_ends_by_ctrl_c_and_leaves_standard_output_to_the_result(
    cloud: Path, tmp_path: Path
) -> None:
    out = tmp_path / "s.json"
    with running("run", "default", "-i", cloud, "-o", out, "--view", "--json") as command:
        assert command.url.startswith("http://127.0.0.1:")
        code, text = command.interrupt()
    assert code == 0, command.told
    assert json.loads(text)["outputs"] == [str(out)]
    assert len(Skeleton.load(out))
    assert not any("Traceback" in line or "viser" in line for line in command.told)


def test_ctrl_c_ends_a_stream_that_is_under_way(tmp_path: Path) -> None:
    for number, points in enumerate(orbit(30)):
        np.save(tmp_path / f"{number}.npy", points)
    words = ["stream", "streaming", "-i", tmp_path, "--rate", "1", "--view"]
    with running(*words, begun=True) as command:
        code, _ = command.interrupt()
    assert code == 130, command.told
    assert not any("Traceback" in line for line in command.told)


@pytest.fixture
def page() -> Iterator[Any]:
    from mdcs_pipeline.viewer.page import LivePage

    with LivePage(port=0) as held:
        yield held


def connected(url: str, origin: str | None) -> Any:
    import viser
    from websockets.sync.client import connect

    protocol = f"viser-v{viser.__version__}"
    address = url.replace("http", "ws")
    return connect(address, origin=origin, subprotocols=[protocol], max_size=None)


@pytest.mark.parametrize("origin", ["https://evil.example", "http://127.0.0.1:1", "null"])
def test_pages_of_other_sites_are_turned_away(page: Any, origin: str) -> None:
    from websockets.exceptions import ConnectionClosed

    with connected(page.url, origin) as stranger, pytest.raises(ConnectionClosed) as caught:
        stranger.recv(10)
    assert caught.value.rcvd is not None
    assert caught.value.rcvd.code == 1008


@pytest.mark.parametrize("named", [True, False])
def test_its_own_page_and_programs_are_let_in(page: Any, named: bool) -> None:
    with connected(page.url, page.url if named else None) as own:
        assert len(own.recv(10)) > 100


def test_no_one_digs_a_tunnel_to_the_internet(page: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    import msgspec
    from viser import _viser

    dug: list[object] = []

    class Tunnel:
        def __init__(self, *given: object) -> None:
            dug.append(given)

        def __getattr__(self, name: str) -> Any:
            return lambda *_: None

    monkeypatch.setattr(_viser, "ViserTunnel", Tunnel)
    with connected(page.url, page.url) as own:
        own.recv(10)
        own.send(msgspec.msgpack.encode({"type": "ShareUrlRequest"}))
        # Answered after the request, as messages of one client are taken in order.
        own.ping().wait(10)
        own.send(msgspec.msgpack.encode({"type": "ShareUrlRequest"}))
        own.ping().wait(10)
    # Both were handed to threads that end when the server does.
    page.close()
    page._server._thread_executor.shutdown(wait=True)
    assert dug == []


# --- the browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    sync_api = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed")
    with sync_api.sync_playwright() as play:
        # Root may start Chromium without its sandbox only.
        unboxed = ["--no-sandbox"] if os.geteuid() == 0 else []
        held = play.chromium.launch(executable_path=CHROMIUM, args=[*FLAGS, *unboxed])
        yield held
        held.close()


class Visitor:
    """A browser tab on a page, and every fault that it met."""

    def __init__(self, browser: Any, url: str) -> None:
        self.tab = browser.new_page(viewport={"width": 1000, "height": 700})
        self.faults: list[str] = []
        self.tab.on("pageerror", lambda error: self.faults.append(str(error)))
        self.tab.on(
            "console",
            lambda told: self.faults.append(told.text) if told.type == "error" else None,
        )
        self.tab.on("requestfailed", lambda request: self.faults.append(request.url))
        self.tab.goto(url)
        self.tab.get_by_role("button", name="Save skeleton").wait_for(timeout=WAIT)
        self._close_notice()

    def _close_notice(self) -> None:
        # Chromium's own renderer in software is what viser warns of; it covers the picture.
        notice = self.tab.locator(".mantine-Notification-closeButton")
        with contextlib.suppress(Exception):
            notice.first.click(timeout=3000)

    def picture(self) -> np.ndarray:
        """Return the scene as (H, W, 3) once it no longer changes."""
        image = pytest.importorskip("PIL.Image")
        canvas = self.tab.locator("canvas").first
        last = None
        for _ in range(40):
            self.tab.wait_for_timeout(500)
            shot = np.asarray(image.open(io.BytesIO(canvas.screenshot())).convert("RGB"), int)
            seen = shot[:, :600]
            if last is not None and np.array_equal(seen, last) and (seen < 240).any():
                return seen
            last = seen
        raise AssertionError("the picture never came to rest")

    def count(self, name: str) -> int:
        found = re.search(rf"{name} (\d+)", self.tab.locator("body").inner_text())
        assert found is not None
        return int(found[1])

    def frames(self) -> tuple[int, int]:
        """Return the number of the frame shown, and how many there are."""
        found = re.search(r"frame (\d+) of (\d+)", self.tab.locator("body").inner_text())
        assert found is not None
        return int(found[1]), int(found[2])

    def slider(self, name: str) -> Any:
        row = self.tab.get_by_text(name, exact=True).locator("xpath=ancestor::div[2]")
        return row.locator("[role=slider]")


@contextlib.contextmanager
def visit(browser: Any, command: Command) -> Iterator[Visitor]:
    visitor = Visitor(browser, command.url)
    yield visitor
    visitor.tab.close()
    assert visitor.faults == []


def coloured(picture: np.ndarray) -> int:
    """Count pixels with a hue: only the tubes have one."""
    return int(np.count_nonzero(np.ptp(picture, axis=2) > 60))


def grey(picture: np.ndarray) -> int:
    """Count pixels of the cloud's colour."""
    return int(np.count_nonzero(np.abs(picture - (196, 200, 204)).max(axis=2) < 12))


def test_the_page_draws_and_its_controls_change_the_picture(
    browser: Any, cloud: Path, tmp_path: Path
) -> None:
    with running("view", cloud) as command, visit(browser, command) as visitor:
        first = visitor.picture()
        assert coloured(first) > 1000
        assert grey(first) > 1000
        assert "thickness" in visitor.tab.locator("table").inner_text()

        visitor.tab.get_by_role("checkbox", name="cloud").click()
        bare = visitor.picture()
        assert grey(bare) < grey(first) / 10
        assert coloured(bare) >= coloured(first)
        visitor.tab.get_by_role("checkbox", name="skeleton").click()
        visitor.tab.get_by_role("checkbox", name="cloud").click()
        assert coloured(visitor.picture()) < coloured(first) / 10
        visitor.tab.get_by_role("checkbox", name="skeleton").click()

        nodes = visitor.count("nodes")
        dial = visitor.slider("ε")
        dial.focus()
        dial.press("End")
        visitor.tab.wait_for_function(
            f"!document.body.innerText.includes('nodes {nodes}')", timeout=WAIT
        )
        again = visitor.picture()
        assert visitor.count("nodes") < nodes
        assert np.count_nonzero((again != first).any(axis=2)) > 500

        with visitor.tab.expect_download(timeout=WAIT) as held:
            visitor.tab.get_by_role("button", name="Save skeleton").click()
        assert held.value.suggested_filename == "animal.json"
        held.value.save_as(tmp_path / "s.json")
        assert len(Skeleton.load(tmp_path / "s.json")) == visitor.count("nodes")
        settings = json.loads((tmp_path / "s.json").read_text())["settings"]
        # The dial ends at four times what the configuration says.
        usual = load_spec("default").stages["transport"].settings["epsilon"]
        assert settings["transport"]["epsilon"] == pytest.approx(4 * usual)
        assert command.interrupt()[0] == 0


def test_frames_slide_and_play(browser: Any, tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    points = demo_cloud(1500)
    for number, stretch in enumerate((1.0, 1.3, 1.6)):
        np.save(frames / f"{number}.npy", points * (stretch, 1.0, 1.0))
    with running("run", "default", "-i", frames, "--view") as command:
        with visit(browser, command) as visitor:
            assert "frame 3 of 3" in visitor.tab.locator("body").inner_text()
            last = visitor.picture()
            slider = visitor.slider("frame")
            slider.focus()
            slider.press("Home")
            visitor.tab.get_by_text("frame 1 of 3").wait_for(timeout=WAIT)
            first = visitor.picture()
            assert np.count_nonzero((first != last).any(axis=2)) > 2000
            visitor.tab.get_by_role("button", name="Play").click()
            visitor.tab.get_by_text("frame 3 of 3").wait_for(timeout=WAIT)
            np.testing.assert_array_equal(visitor.picture(), last)
        assert command.interrupt()[0] == 0


def test_a_page_fed_by_a_stream_follows_it_until_paused(browser: Any) -> None:
    from mdcs_pipeline.viewer.film import Frame
    from mdcs_pipeline.viewer.page import LivePage

    points = demo_cloud(500)

    def tube(count: int) -> Skeleton:
        nodes = np.linspace((-0.9, 0, 0.5), (0.9, 0, 0.5), count)
        edges = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
        return Skeleton(nodes, edges, np.full(count, 1 / count), np.ones(count), np.arange(count))

    with LivePage(port=0) as page:
        page.show(Frame("stream", points, tube(2)))
        visitor = Visitor(browser, page.url)
        for count in (3, 4):
            page.show(Frame("stream", points, tube(count)))
        visitor.tab.get_by_text("frame 3 of 3").wait_for(timeout=WAIT)
        assert visitor.count("nodes") == 4
        visitor.tab.get_by_role("button", name="Pause").click()
        visitor.tab.get_by_role("button", name="Play").wait_for(timeout=WAIT)
        page.show(Frame("stream", points, tube(5)))
        visitor.tab.get_by_text("frame 3 of 4").wait_for(timeout=WAIT)
        assert visitor.count("nodes") == 4
        visitor.tab.get_by_role("button", name="Play").click()
        visitor.tab.get_by_text("frame 4 of 4").wait_for(timeout=WAIT)
        assert visitor.count("nodes") == 5
        assert visitor.faults == []
        visitor.tab.close()


def test_a_stream_is_seen_paused_and_made_again(browser: Any, tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    count = 40
    for number, points in enumerate(orbit(count, laps=2.0)):
        np.save(folder / f"{number}.npy", points)
    out = tmp_path / "s.json"
    words = ["stream", "streaming", "--set", f"scene.voxel_size={VOXEL}", "-i", folder, "-o", out]
    with running(*words, "--rate", "2", "--view", begun=True) as command:
        with visit(browser, command) as visitor:
            tab = visitor.tab
            tab.get_by_role("button", name="Pause").click(timeout=WAIT)
            tab.get_by_text("paused: no more frames are read").wait_for(timeout=WAIT)
            early = visitor.picture()
            assert coloured(early) > 500
            assert grey(early) > 500
            assert "transport" in tab.locator("table").inner_text()
            held = visitor.frames()
            # Long enough for three more at this rate.
            tab.wait_for_timeout(1500)
            assert visitor.frames() == held
            assert held[1] < count
            tab.get_by_role("button", name="Play").click()
            tab.get_by_text("ready", exact=True).wait_for(timeout=WAIT)
            assert visitor.frames()[1] >= count
            late = visitor.picture()
            assert np.count_nonzero((late != early).any(axis=2)) > 2000

            # Back in its history and to the end again, then another ε for what is there.
            slider = visitor.slider("frame")
            slider.focus()
            slider.press("Home")
            tab.get_by_text(f"cloud 1, frame 1 of {visitor.frames()[1]}").wait_for(timeout=WAIT)
            assert "transport" in tab.locator("table").inner_text()
            slider.press("End")
            whole = visitor.frames()[1]
            tab.get_by_text(f"frame {whole} of {whole}").wait_for(timeout=WAIT)
            nodes = visitor.count("nodes")
            dial = visitor.slider("ε")
            dial.focus()
            dial.press("End")
            tab.wait_for_function(
                f"!document.body.innerText.includes('nodes {nodes}')", timeout=WAIT
            )
            assert visitor.count("nodes") < nodes
            with tab.expect_download(timeout=WAIT) as download:
                tab.get_by_role("button", name="Save skeleton").click()
            named = (f"cloud_{count}.json", "end_of_the_scene.json")
            assert download.value.suggested_filename in named
            download.value.save_as(tmp_path / "again.json")
            assert len(Skeleton.load(tmp_path / "again.json")) == visitor.count("nodes")
        code, _ = command.interrupt()
        assert code == 0, command.told
    assert len(Skeleton.load(out))
