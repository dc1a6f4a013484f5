"""Pictures and pages: they show the skeleton, and need nothing from elsewhere."""

from __future__ import annotations

import base64
import builtins
import io
import re
import sys
import zlib
from html.parser import HTMLParser

import numpy as np
import pytest

from mdcs_pipeline.errors import InputError, MissingExtraError
from mdcs_pipeline.io import page, scene
from mdcs_pipeline.io.scene import MOST_POINTS, drawn_points, make_scene, view_axes
from mdcs_pipeline.io.write import write_skeleton
from mdcs_pipeline.skeleton import Skeleton

RED = (0xC8, 0x10, 0x2E)
BLUE = (0x1F, 0x3A, 0x93)
GREY = (0xC4, 0xC8, 0xCC)


def ring(count=24, radius=3.0, shift=(0.0, 0.0, 0.0), heavy=None):
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    nodes = radius * np.c_[np.cos(angle), np.sin(angle), 0 * angle] + shift
    edges = [(i, i + 1) for i in range(count - 1)] + [(0, count - 1)]
    mass = np.ones(count)
    if heavy is not None:
        mass[heavy] = 100.0
    return Skeleton(nodes, np.array(edges), mass / mass.sum(), np.ones(count), np.arange(count))


def torus(count, shift=(0.0, 0.0, 0.0)):
    a, b = np.random.default_rng(3).uniform(0, 2 * np.pi, (2, count))
    ring_ = 3 + np.cos(b)
    return np.c_[ring_ * np.cos(a), ring_ * np.sin(a), np.sin(b)] + shift


def lone(count):
    nodes = np.zeros((count, 3))
    mass = np.full(count, 1 / max(count, 1))
    return Skeleton(nodes, np.empty((0, 2), np.int64), mass, mass, np.arange(count))


# --- what is drawn -------------------------------------------------------------------------


def test_large_clouds_are_sampled_always_the_same():
    cloud = torus(MOST_POINTS + 1000)
    one, two = drawn_points(cloud), drawn_points(cloud)
    assert len(one) == MOST_POINTS
    np.testing.assert_array_equal(one, two)
    assert len(np.unique(one, axis=0)) == MOST_POINTS
    assert {*map(tuple, one)} <= {*map(tuple, cloud)}


def test_small_clouds_are_drawn_whole_but_for_nan():
    cloud = torus(100).astype(np.float32)
    cloud[7, 1] = np.nan
    points = drawn_points(cloud)
    np.testing.assert_array_equal(points, np.delete(cloud, 7, axis=0))
    assert points.dtype == np.float64
    assert drawn_points(None).shape == (0, 3)
    with pytest.raises(InputError, match="cloud must have the shape"):
        drawn_points(np.zeros((4, 2)))


def test_scene_is_centred():
    cloud = torus(500, shift=(1e6, -2e6, 5.0))
    made = make_scene(cloud[:9], cloud)
    np.testing.assert_allclose(made.cloud + made.centre, cloud, rtol=1e-15, atol=1e-9)
    np.testing.assert_allclose(made.nodes, made.cloud[:9])
    assert np.abs(made.cloud).max() <= made.size
    empty = make_scene(np.empty((0, 3)), None)
    assert empty.size == 1.0
    assert make_scene(np.ones((1, 3)), None).size == 1.0


@pytest.mark.parametrize("seed", range(8))
def test_view_axes_are_a_rotation_with_the_flat_side_to_the_viewer(seed):
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    points = rng.normal(size=(400, 3)) * [9, 4, 1] @ turn
    axes = view_axes(points)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    spread = (points @ axes.T).std(axis=0)
    assert spread[1] < min(spread[0], spread[2])


def test_a_standing_shape_stays_standing():
    points = np.random.default_rng(0).normal(size=(400, 3)) * [2, 1, 9]
    axes = view_axes(points)
    assert axes[2] @ [0, 0, 1] > 0.99
    np.testing.assert_array_equal(view_axes(points[:1]), np.eye(3))


# --- PNG -----------------------------------------------------------------------------------


def pixels(path):
    image = pytest.importorskip("matplotlib.image")
    return np.round(image.imread(path)[:, :, :3] * 255).astype(int)


def near(picture, colour, most=12):
    return np.abs(picture - colour).max(axis=2) <= most


def panels(mask):
    return np.split(mask, 3, axis=1)


@pytest.mark.parametrize("shift", [(0, 0, 0), (1e6, -4e6, 300)])
def test_png_shows_cloud_lines_and_nodes_in_three_views(tmp_path, shift):
    write_skeleton(ring(shift=shift), tmp_path / "a.png", cloud=torus(20000, shift))
    picture = pixels(tmp_path / "a.png")
    assert picture.shape == (600, 1500, 3)
    for colour, least in ((RED, 400), (BLUE, 200), (GREY, 10_000)):
        for panel in panels(near(picture, colour)):
            assert panel.sum() > least
    border = np.concatenate([picture[:3].reshape(-1, 3), picture[-3:].reshape(-1, 3)])
    assert (border == 255).all()
    assert (picture[:, [0, 499, 500, 999, 1000, 1499]] == 255).all()


def test_png_has_equal_axes_and_shows_all(tmp_path):
    """Seen face on, a ring is as wide as it is high, and no part of it is cut off."""
    write_skeleton(ring(), tmp_path / "a.png", cloud=torus(20000))
    picture = pixels(tmp_path / "a.png")
    for colour in (RED, GREY):
        y, x = np.nonzero(panels(near(picture, colour))[0])
        assert np.ptp(x) == pytest.approx(np.ptp(y), abs=8)
    lines = np.ptp(np.nonzero(panels(near(picture, RED))[0])[0])
    cloud = np.ptp(np.nonzero(panels((picture < 250).any(axis=2))[0])[0])
    assert lines / cloud == pytest.approx(6 / 8, abs=0.03)


def test_png_nodes_grow_with_mass(tmp_path):
    write_skeleton(ring(heavy=0), tmp_path / "a.png")
    blue = panels(near(pixels(tmp_path / "a.png"), BLUE))[0]
    y, x = np.nonzero(blue)
    shares = [
        np.count_nonzero(np.hypot(x - x0, y - y0) < 9)
        for x0, y0 in zip(*np.nonzero(blue)[::-1], strict=True)
    ]
    assert max(shares) > 2.5 * np.median([s for s in shares if s < max(shares) / 2])


def test_png_skeleton_lies_over_the_cloud(tmp_path):
    one = ring()
    write_skeleton(one, tmp_path / "a.png")
    alone = near(pixels(tmp_path / "a.png"), RED).sum()
    write_skeleton(one, tmp_path / "b.png", cloud=one.nodes.repeat(50, axis=0))
    assert near(pixels(tmp_path / "b.png"), RED).sum() == pytest.approx(alone, rel=0.05)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_png_and_html_of_little(tmp_path, count):
    for module in ("matplotlib", "k3d"):
        pytest.importorskip(module)
    for cloud in (None, torus(10), np.ones((4, 3))):
        for suffix in (".png", ".html"):
            write_skeleton(lone(count), tmp_path / f"a{suffix}", cloud=cloud)
    write_skeleton(lone(0), tmp_path / "b.png")
    assert (pixels(tmp_path / "b.png") == 255).all()


def test_png_leaves_pyplot_alone(tmp_path):
    pytest.importorskip("matplotlib")
    loaded = "matplotlib.pyplot" in sys.modules
    write_skeleton(ring(), tmp_path / "a.png")
    assert ("matplotlib.pyplot" in sys.modules) == loaded


# --- HTML ----------------------------------------------------------------------------------


class Loads(HTMLParser):
    """Collects what a page loads from elsewhere."""

    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        if tag in ("link", "iframe", "img", "object", "embed", "base") or "src" in values:
            self.found.append((tag, values))
        if "url(" in (values.get("style") or ""):
            self.found.append((tag, values))


def snapshot(path):
    """Return the objects that a page draws, by name, and the plot's own settings."""
    pytest.importorskip("k3d")
    msgpack = pytest.importorskip("msgpack")
    data = re.search(r"var data = '([^']+)'", path.read_text(encoding="utf-8")).group(1)
    held = msgpack.unpackb(zlib.decompress(base64.b64decode(data)), strict_map_key=False)
    return {item["name"]: item for item in held["objects"]}, held["plot"]


def array(item):
    raw = item.get("data", item.get("compressed_data"))
    raw = zlib.decompress(item["compressed_data"]) if "compressed_data" in item else raw
    return np.frombuffer(bytes(raw), item["dtype"]).reshape(item["shape"])


def test_html_holds_all_that_it_needs(tmp_path):
    pytest.importorskip("k3d")
    write_skeleton(ring(), tmp_path / "a.html", cloud=torus(1000))
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    loads = Loads()
    loads.feed(text)
    assert loads.found == []
    assert "@import" not in text
    # The viewer itself is in the page: unpacked, it defines what the page calls.
    packed = re.search(r"k3dCompressed = '([^']+)'", text).group(1)
    viewer = zlib.decompress(base64.b64decode(packed)).decode()
    assert "CreateK3DAndLoadBinarySnapshot" in viewer
    # Outside of the packed viewer, addresses stand in names and messages alone.
    found = set(re.findall(r"https?://[^\s\"'`<>)\\]+", text))
    assert found <= {"http://www.w3.org/1999/xhtml", "https://requirejs.org/docs/errors.html#"}


def test_html_draws_cloud_tubes_and_nodes_in_world_units(tmp_path):
    one, cloud = ring(heavy=2), torus(1000)
    write_skeleton(one, tmp_path / "a.html", cloud=cloud)
    objects, plot = snapshot(tmp_path / "a.html")
    np.testing.assert_allclose(array(objects["cloud"]["positions"]), cloud, rtol=1e-6, atol=1e-6)
    lines = objects["skeleton"]
    np.testing.assert_allclose(array(lines["vertices"]), one.nodes, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(array(lines["indices"]).reshape(-1, 2), one.edges)
    size = np.linalg.norm(np.ptp(cloud, axis=0))
    assert 0.004 * size < lines["width"] < 0.02 * size
    nodes = objects["nodes, coloured by mass"]
    np.testing.assert_allclose(array(nodes["attribute"]), one.mass, rtol=1e-6)
    assert nodes["color_range"][1] == pytest.approx(one.mass.max())
    assert np.argmax(array(nodes["point_sizes"])) == 2
    assert plot["axes"] == ["x", "y", "z"]


def test_html_far_from_the_origin_keeps_its_digits(tmp_path):
    shift = np.array([4e6 + 0.25, -5e5, 100.0])
    one = ring(shift=shift)
    write_skeleton(one, tmp_path / "a.html", cloud=torus(500, shift))
    objects, plot = snapshot(tmp_path / "a.html")
    offsets = [float(label.partition("−")[2] or 0) for label in plot["axes"]]
    drawn = array(objects["skeleton"]["vertices"]).astype(float) + offsets
    np.testing.assert_allclose(drawn, one.nodes, atol=1e-5)
    assert offsets[0] == 4e6


def test_html_samples_large_clouds(tmp_path, monkeypatch):
    monkeypatch.setattr(scene, "MOST_POINTS", 200)
    write_skeleton(ring(), tmp_path / "a.html", cloud=torus(1000))
    objects, _ = snapshot(tmp_path / "a.html")
    assert array(objects["cloud"]["positions"]).shape == (200, 3)


def test_html_closes_its_widgets(tmp_path):
    pytest.importorskip("k3d")
    widgets = pytest.importorskip("ipywidgets.widgets.widget")
    write_skeleton(ring(), tmp_path / "a.html", cloud=torus(100))
    before = len(widgets._instances)
    write_skeleton(ring(), tmp_path / "a.html", cloud=torus(100))
    assert len(widgets._instances) == before


def test_page_offset_is_round_and_only_for_far_clouds():
    assert (page.page_offset(make_scene(torus(99), None)) == 0).all()
    far = make_scene(torus(99, (123456.7, 0, 0)), None)
    offset = page.page_offset(far)
    assert offset[0] == pytest.approx(123460, abs=10)
    assert float(f"{offset[0]:.15g}") == offset[0]


# --- without the extra ---------------------------------------------------------------------


@pytest.mark.parametrize(("suffix", "module"), [(".png", "matplotlib"), (".html", "k3d")])
def test_missing_extra_is_named(tmp_path, monkeypatch, suffix, module):
    really = builtins.__import__

    def importing(name, *args, **kwargs):
        if name.partition(".")[0] == module:
            raise ModuleNotFoundError(f"No module named '{module}'", name=module)
        return really(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", importing)
    with pytest.raises(MissingExtraError) as caught:
        write_skeleton(ring(), tmp_path / f"a{suffix}")
    assert "mdcs-pipeline[draw]" in str(caught.value)
    assert module in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_png_is_a_png(tmp_path):
    pytest.importorskip("matplotlib")
    write_skeleton(ring(), tmp_path / "a.PNG")
    data = io.BytesIO((tmp_path / "a.PNG").read_bytes())
    assert data.read(8) == b"\x89PNG\r\n\x1a\n"
