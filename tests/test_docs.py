"""The documentation is true: every block of code runs, and every link leads somewhere."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from fake_viser import closed_at_once, shown
from typer.testing import CliRunner

from mdcs_pipeline.cli.app import app
from mdcs_pipeline.config import load_spec
from mdcs_pipeline.graph import build_graph
from mdcs_pipeline.stage import stage_class, stage_names

if sys.version_info >= (3, 11):
    import tomllib
else:
    tomllib = pytest.importorskip("tomli")

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = sorted(str(path.relative_to(DOCS)) for path in DOCS.rglob("*.md"))
# Text is not run: layouts, and commands that need ROS, dora or several machines.
LANGUAGES = {"python", "sh", "yaml", "toml", "text"}
BLOCK = re.compile(r'^```(\w*)(?: title="([\w.-]+)")?\n(.*?)^```$', re.DOTALL | re.MULTILINE)
NEEDS = {
    "howto/open3d.md": ("open3d",),
    "howto/bags.md": ("rosbags",),
    "wire.md": ("pyarrow",),
    "howto/measure.md": ("open3d", "matplotlib", "k3d"),
    "howto/page.md": ("open3d", "matplotlib", "k3d"),
}


class Page:
    """Runs the blocks of a page one after the other, as its reader would."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.plugins = folder / "plugins"
        self.space: dict[str, Any] = {}

    def run(self, language: str, title: str, text: str) -> None:
        if title:
            (self.folder / title).write_text(text, encoding="utf-8")
        if language == "yaml":
            # What a stage of the page's own is needed for is validated by its commands.
            if {s.get("stage", k) for k, s in _stages(text).items()} <= {*stage_names()}:
                build_graph(load_spec(self.folder / title))
        elif language == "toml":
            tomllib.loads(text)
        elif language == "python" and not title:
            exec(compile(text, "block", "exec"), self.space)
        elif language == "sh":
            for line in text.splitlines():
                self.command(shlex.split(line))

    def command(self, words: list[str]) -> None:
        python = [sys.executable, "-m"]
        if words[:2] == ["pip", "install"]:
            (what,) = words[2:]
            if what != ".":
                self.check_extras(what)
                return
            options = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet"]
            line = [*python, "pip", "install", *options, "--target", str(self.plugins), "."]
        elif words[:2] == ["mdcs", "view"] or "--view" in words:
            self.viewed(words)
            return
        else:
            assert words[0] == "mdcs", words
            line = [*python, "mdcs_pipeline", *words[1:]]
        path = os.pathsep.join(filter(None, [str(self.plugins), os.environ.get("PYTHONPATH")]))
        done = subprocess.run(
            line,
            cwd=self.folder,
            env={**os.environ, "PYTHONPATH": path},
            capture_output=True,
            text=True,
            timeout=240,
            check=False,
        )
        assert done.returncode == 0, (words, done.stdout, done.stderr)

    @staticmethod
    def viewed(words: list[str]) -> None:
        """Run what shows a page, within this process: nobody is there to press Ctrl-C."""
        with pytest.MonkeyPatch.context() as patch:
            pages = closed_at_once(patch)
            done = CliRunner().invoke(app, words[1:])
            assert done.exit_code == 0, (words, done.stderr)
            assert all(frame.skeleton is not None for frame in shown(pages[0]))

    @staticmethod
    def check_extras(what: str) -> None:
        project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        (extras,) = re.findall(r"^\.\[([\w,-]+)\]$", what)
        assert set(extras.split(",")) <= project["optional-dependencies"].keys()


def _stages(text: str) -> dict[str, Any]:
    import yaml

    found = yaml.safe_load(text)["stages"]
    return {name: stage or {} for name, stage in found.items()}


def text_of(page: str) -> str:
    return (DOCS / page).read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES)
def test_every_block_runs(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in NEEDS.get(page, ()):
        pytest.importorskip(module, exc_type=ImportError)
    text = text_of(page)
    blocks = BLOCK.findall(text)
    # A fence of another form would go by unseen.
    assert len(blocks) * 2 == len(re.findall(r"^ *```", text, flags=re.MULTILINE))
    assert {language for language, _, _ in blocks} <= LANGUAGES
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    # No block of Python ends by Ctrl-C.
    closed_at_once(monkeypatch, by_key=False)
    page_ = Page(tmp_path)
    for language, title, body in blocks:
        assert title or language not in ("yaml", "toml")
        page_.run(language, title, body)


def test_the_navigation_has_every_page() -> None:
    listed = re.findall(r"[\w/]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    assert sorted(listed) == sorted([*PAGES, "reference/settings.md"])


def test_the_settings_page_has_every_setting() -> None:
    pytest.importorskip("mkdocs")
    import importlib.util

    spec = importlib.util.spec_from_file_location("pages", DOCS / "pages.py")
    assert spec is not None
    assert spec.loader is not None
    pages = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(pages)
    page = pages.settings_page()
    sections = dict(re.findall(r"^## (\w+)\n(.*?)(?=^## |\Z)", page, re.DOTALL | re.MULTILINE))
    assert sorted(sections) == stage_names()
    for name, section in sections.items():
        found = re.findall(r"^\| `(\w+)` \|", section, flags=re.MULTILINE)
        assert found == list(stage_class(name).Settings.model_fields)
        rows = [line for line in section.splitlines() if line.startswith("|")]
        assert {len(re.findall(r"(?<!\\)\|", row)) for row in rows} <= {6}


def test_the_list_of_formats_is_the_writers() -> None:
    from mdcs_pipeline.io.write import SKELETON_SUFFIXES

    table = text_of("index.md").partition("| suffix |")[2]
    named = re.findall(r"`(\.\w+)`", "\n".join(re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)))
    assert sorted(named) == sorted([*SKELETON_SUFFIXES, ".mcap"])


def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    """Links, anchors, cross references and docstrings; figures are drawn on the way."""
    pytest.importorskip("mkdocs")
    pytest.importorskip("mkdocstrings")
    pytest.importorskip("matplotlib")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    for figure in ("steps.png", "epsilon.png", "default.svg"):
        assert (tmp_path / "site" / "figures" / figure).stat().st_size > 10_000
    assert not list((tmp_path / "site").rglob("*.py"))
    # The site must work where there is no network: nothing in it is fetched from elsewhere.
    for page in (tmp_path / "site").rglob("*.html"):
        fetched = r'<(?:script|img|link)[^>]+(?:src|href)="(https?://[^"]+)'
        assert re.findall(fetched, page.read_text(encoding="utf-8")) == []
