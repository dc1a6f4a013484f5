"""The live page over a server without sockets: what it shows, and what it does when told to."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from fake_viser import Server

from mdcs_pipeline.cli.gallery import skeleton_frames, sort_paths
from mdcs_pipeline.errors import InputError, StageError
from mdcs_pipeline.skeleton import Skeleton
from mdcs_pipeline.viewer import page as page_module
from mdcs_pipeline.viewer.film import Dial, Frame
from mdcs_pipeline.viewer.page import LivePage

POINTS = np.random.default_rng(0).normal(size=(200, 3))


def line(count: int) -> Skeleton:
    """A straight skeleton of `count` nodes."""
    nodes = np.zeros((count, 3))
    nodes[:, 0] = np.arange(count)
    edges = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
    mass = np.full(count, 1 / count)
    seconds = {"seconds": {"seed": 0.001 * count}}
    return Skeleton(nodes, edges, mass, np.ones(count), np.arange(count), diagnostics=seconds)


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Server:
    held = Server()
    monkeypatch.setattr(page_module, "open_server", lambda host, port, title: held)
    return held


@pytest.fixture
def served() -> Iterator[Callable[[LivePage], None]]:
    """Serve a page in a thread of its own until the test is over."""
    running: list[tuple[LivePage, threading.Thread]] = []

    def start(page: LivePage) -> None:
        thread = threading.Thread(target=page.serve)
        thread.start()
        running.append((page, thread))

    yield start
    for page, thread in running:
        page.close()
        thread.join(10)
        assert not thread.is_alive()


def soon(true: Callable[[], bool]) -> bool:
    end = time.monotonic() + 10
    while not true() and time.monotonic() < end:
        time.sleep(0.01)
    return true()


def tubes(server: Server) -> int:
    """Half edges in the scene."""
    handle = server.scene.things.get("/skeleton/edges")
    return 0 if handle is None else len(handle.positions)


def test_a_frame_is_shown_as_it_comes_and_the_skeleton_when_it_is_done(server: Server) -> None:
    with LivePage() as page:
        assert page.url == "http://127.0.0.1:4711"
        page.show(Frame("scan", POINTS))
        assert len(server.scene.things["/cloud"].points) == 200
        assert tubes(server) == 0
        assert server.gui.by_label["Save skeleton"].disabled
        page.amend(Frame("scan", POINTS, line(5)))
        assert tubes(server) == 8
        assert len(server.scene.things["/skeleton/nodes"].positions) == 5
        assert "nodes 5" in server.gui.written
        assert "| seed | 5.0 |" in server.gui.written
    assert server.stopped


def test_a_frame_without_a_skeleton_takes_the_last_ones_away(server: Server) -> None:
    with LivePage() as page:
        page.show(Frame("a", POINTS, line(5)))
        page.show(Frame("b", POINTS))
        assert "/skeleton/edges" not in server.scene.things
        assert "/skeleton/nodes" not in server.scene.things
        page.show(Frame("c", None, line(1)))
        assert not server.scene.things["/cloud"].visible
        assert "/skeleton/edges" not in server.scene.things
        assert len(server.scene.things["/skeleton/nodes"].positions) == 1


def test_nothing_at_all_is_shown_without_a_fault(server: Server) -> None:
    with LivePage() as page:
        page.show(Frame("empty"))
        assert server.scene.things == {}
        page.show(Frame("then a cloud", POINTS))
        assert len(server.scene.things["/cloud"].points) == 200


def test_a_paused_page_stands_still_and_holds_up_nobody(server: Server) -> None:
    with LivePage() as page:
        page.show(Frame("0", skeleton=line(2)))
        page.show(Frame("1", skeleton=line(3)))
        assert server.gui.by_label["Pause"].visible
        server.gui.by_label["Pause"].by_user()
        assert server.gui.by_label["Pause"].label == "Play"
        page.show(Frame("2", skeleton=line(4)))
        assert tubes(server) == 4
        assert server.gui.by_label["frame"].max == 3
        server.gui.by_label["Pause"].by_user()
        assert tubes(server) == 6


def test_who_waits_for_a_paused_page_goes_on_when_it_plays(server: Server) -> None:
    page = LivePage()
    page.show(Frame("0", skeleton=line(2)))
    page.wait_to_play()
    page.show(Frame("1", skeleton=line(3)))
    # Looking back at an earlier frame stops it as the button does.
    for stop in ("Pause", "frame"):
        server.gui.by_label[stop].by_user(1 if stop == "frame" else None)
        assert page.paused
        thread = threading.Thread(target=page.wait_to_play)
        thread.start()
        before = page.clock()
        thread.join(0.2)
        assert thread.is_alive()
        # A pause takes no time on the page's clock.
        assert page.clock() == before
        server.gui.by_label["Pause"].by_user()
        thread.join(10)
        assert not thread.is_alive()
        assert before <= page.clock() < time.monotonic()


@pytest.mark.parametrize("end", ["finish", "close"])
def test_the_end_of_a_stream_or_a_page_lets_who_waits_go(server: Server, end: str) -> None:
    page = LivePage()
    for count in (2, 3):
        page.show(Frame("", skeleton=line(count)))
    server.gui.by_label["Pause"].by_user()
    thread = threading.Thread(target=page.wait_to_play)
    thread.start()
    getattr(page, end)()
    thread.join(10)
    assert not thread.is_alive()


def test_the_view_steps_back_from_a_scene_that_outgrows_it(server: Server) -> None:
    page = LivePage()
    camera = server.client.camera
    page.show(Frame("0", POINTS), widen=True)
    near = np.array(camera.position)
    places = server.scene.things["/cloud"].points
    page.show(Frame("1", POINTS * 0.9), widen=True)
    np.testing.assert_array_equal(camera.position, near)
    dot = server.scene.things["/cloud"].point_size
    far = np.concatenate([POINTS, POINTS + np.array([40.0, 0, 0])])
    page.show(Frame("2", far))
    np.testing.assert_array_equal(camera.position, near)
    page.show(Frame("3", far), widen=True)
    # As far from its middle as its size asks for, and the first points stand where they stood.
    middle = (far.max(axis=0) + far.min(axis=0)) / 2
    extent = np.linalg.norm(np.ptp(far, axis=0)) / np.linalg.norm(np.ptp(POINTS, axis=0))
    reach = np.linalg.norm(np.subtract(camera.position, camera.look_at))
    assert reach == pytest.approx(1.25 * extent * np.linalg.norm(near))
    # Seen from there, points are as large as they were.
    assert server.scene.things["/cloud"].point_size == pytest.approx(1.25 * extent * dot)
    scale = np.linalg.norm(np.ptp(places, axis=0)) / np.linalg.norm(np.ptp(POINTS, axis=0))
    first = (POINTS.max(axis=0) + POINTS.min(axis=0)) / 2
    np.testing.assert_allclose(camera.look_at, (middle - first) * scale, atol=1e-6)
    np.testing.assert_allclose(server.scene.things["/cloud"].points[:200], places, atol=1e-5)
    # There is room to grow on.
    stood = np.array(camera.position)
    page.show(Frame("a little more", far + np.array([0.5, 0, 0])), widen=True)
    np.testing.assert_array_equal(camera.position, stood)
    # Who has moved is left alone.
    camera.position = stood = np.array([1.0, 2.0, 3.0])
    page.show(Frame("4", far * 10), widen=True)
    np.testing.assert_array_equal(camera.position, stood)


def test_the_frame_slider_shows_that_frame(server: Server) -> None:
    with LivePage() as page:
        for count in (2, 3, 4):
            page.show(Frame(f"{count}", skeleton=line(count)))
        slider = server.gui.by_label["frame"]
        assert (slider.min, slider.max, slider.value) == (1, 3, 3)
        slider.by_user(1)
        assert tubes(server) == 2
        # What the page itself sets is no wish.
        slider.by_user(2, client=None)
        assert tubes(server) == 2


def test_it_plays_what_it_holds_to_the_end(
    server: Server, served: Callable[[LivePage], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_module, "_PACE", 0.01)
    page = LivePage()
    for count in (2, 3, 4):
        page.show(Frame(f"{count}", skeleton=line(count)))
    page.finish()
    served(page)
    server.gui.by_label["frame"].by_user(1)
    button = server.gui.by_label["Pause"]
    button.by_user()
    assert soon(lambda: button.label == "Play")
    assert tubes(server) == 6


def test_the_dial_makes_the_frame_again_the_latest_value_wins(
    server: Server, served: Callable[[LivePage], None]
) -> None:
    made: list[float] = []
    busy = threading.Event()

    def again(value: float) -> Frame:
        made.append(value)
        busy.wait(10)
        return Frame("again", skeleton=line(int(value)))

    page = LivePage(dial=Dial("ε", 2.0, 1.0, 9.0))
    page.show(Frame("a", skeleton=line(2), again=again))
    dial = server.gui.by_label["ε"]
    assert dial.disabled, "frames may still come"
    page.finish()
    assert not dial.disabled
    served(page)
    dial.by_user(3.0)
    assert soon(lambda: made == [3.0])
    for value in (4.0, 5.0, 7.0):
        dial.by_user(value)
    busy.set()
    assert soon(lambda: tubes(server) == 12)
    assert made == [3.0, 7.0]
    # Both that were made, and the first, are there at once.
    for value, count in ((3.0, 4), (2.0, 2), (7.0, 12)):
        dial.by_user(value)
        assert tubes(server) == count
    assert made == [3.0, 7.0]


def test_a_failure_is_told_and_the_picture_stays(
    server: Server, served: Callable[[LivePage], None]
) -> None:
    calls: list[float] = []

    def again(value: float) -> Frame:
        calls.append(value)
        raise StageError("no skeleton at this ε", remedy="a smaller one")

    page = LivePage(dial=Dial("ε", 2.0, 1.0, 9.0))
    page.show(Frame("a", skeleton=line(4), again=again))
    page.finish()
    served(page)
    server.gui.by_label["ε"].by_user(8.0)
    assert soon(lambda: "no skeleton at this ε" in server.gui.written)
    assert tubes(server) == 6
    time.sleep(0.05)
    assert calls == [8.0]


def test_looks_change_the_picture(server: Server) -> None:
    with LivePage() as page:
        page.show(Frame("a", POINTS, line(4)))
        before = server.scene.things["/skeleton/edges"]
        server.gui.by_label["colour by"].by_user("branch")
        after = server.scene.things["/skeleton/edges"]
        assert not np.array_equal(before.batched_colors, after.batched_colors)
        assert "grey" in server.gui.written
        server.gui.by_label["tube width"].by_user(2.0)
        wider = server.scene.things["/skeleton/edges"]
        assert wider.batched_scales[0, 0] > before.batched_scales[0, 0]
        server.gui.by_label["cloud"].by_user(False)
        assert not server.scene.things["/cloud"].visible
        server.gui.by_label["skeleton"].by_user(False)
        assert "/skeleton/edges" not in server.scene.things


def test_fit_moves_the_cameras_to_what_is_shown_now(server: Server) -> None:
    with LivePage() as page:
        page.show(Frame("small", POINTS))
        page.show(Frame("large", POINTS * 50))
        seen = np.abs(server.scene.things["/cloud"].points).max()
        server.gui.by_label["Fit view"].by_user()
        assert np.abs(server.scene.things["/cloud"].points).max() < seen / 20
        assert np.linalg.norm(server.client.camera.position) > 10


@pytest.mark.parametrize("suffix", [".json", ".ply", ".graphml", ".npz", ".swc"])
def test_downloads_are_the_files_that_save_writes(
    server: Server, tmp_path: Path, suffix: str
) -> None:
    with LivePage() as page:
        page.show(Frame("my scan.ply", POINTS, line(4), settings={"seed": {"seed": 3}}))
        server.gui.by_label["format"].by_user(suffix)
        server.gui.by_label["Save skeleton"].by_user(client=server.client)
    ((name, data),) = server.client.files.items()
    assert name == f"my_scan{suffix}"
    if suffix == ".json":
        (tmp_path / name).write_bytes(data)
        np.testing.assert_array_equal(Skeleton.load(tmp_path / name).nodes, line(4).nodes)
        assert json.loads(data)["settings"] == {"seed": {"seed": 3}}
    else:
        assert len(data) > 50


def test_a_format_that_cannot_hold_the_skeleton_is_told(server: Server) -> None:
    ring = Skeleton(
        np.eye(3), np.array([(0, 1), (1, 2), (0, 2)]), np.full(3, 1 / 3), np.ones(3), np.arange(3)
    )
    with LivePage() as page:
        page.show(Frame("ring", None, ring))
        server.gui.by_label["format"].by_user(".swc")
        server.gui.by_label["Save skeleton"].by_user(client=server.client)
        assert server.client.files == {}
        assert "failed" in server.gui.written


def test_the_status_line_speaks_no_faster_than_one_reads(server: Server) -> None:
    with LivePage() as page:
        page.show(Frame("a", POINTS))
        page.say("one")
        page.say("two")
        assert "one" in server.gui.written
        page.say("three", hurry=True)
        assert "three" in server.gui.written
        page.finish()
        assert "three" not in server.gui.written


# --- what `mdcs view` is given


def test_skeletons_are_told_from_clouds_and_paired_by_name(tmp_path: Path) -> None:
    clouds, skeletons = tmp_path / "clouds", tmp_path / "skeletons"
    clouds.mkdir()
    skeletons.mkdir()
    for number in (10, 2):
        np.save(clouds / f"f_{number}.npy", POINTS * number)
        line(number).save(skeletons / f"f_{number}.json")
    (skeletons / "notes.txt").write_text("no skeleton")
    np.savez(tmp_path / "cloud.npz", points=POINTS)
    line(3).save(tmp_path / "skeleton.npz")
    assert sort_paths([clouds, skeletons]) == ([clouds], [skeletons])
    assert sort_paths([tmp_path / "skeleton.npz", tmp_path / "cloud.npz"]) == (
        [tmp_path / "cloud.npz"],
        [tmp_path / "skeleton.npz"],
    )
    frames = skeleton_frames([clouds], [skeletons])
    assert [frame.label for frame in frames] == ["f_2.json", "f_10.json"]
    assert [len(frame.skeleton or ()) for frame in frames] == [2, 10]
    np.testing.assert_array_equal(frames[1].points, POINTS * 10)
    alone = skeleton_frames([], [tmp_path / "skeleton.npz"])
    assert alone[0].points is None
    # A pair needs no common name.
    (pair,) = skeleton_frames([tmp_path / "cloud.npz"], [tmp_path / "skeleton.npz"])
    assert pair.points is not None


def test_what_does_not_go_together_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", POINTS)
    np.save(tmp_path / "b.npy", POINTS)
    for suffix in (".ply", ".json"):
        line(3).save(tmp_path / f"c{suffix}")
    with pytest.raises(InputError, match="more than one cloud") as caught:
        sort_paths([tmp_path / "a.npy", tmp_path / "b.npy"])
    assert "folder" in str(caught.value)
    with pytest.raises(InputError, match="does not hold all of a skeleton"):
        sort_paths([tmp_path / "c.ply"])
    folder = tmp_path / "more"
    folder.mkdir()
    for name in ("a.npy", "b.npy"):
        np.save(folder / name, POINTS)
    with pytest.raises(InputError, match="no clouds have the skeleton's name"):
        skeleton_frames([folder], [tmp_path / "c.json"])
