"""What the documentation's build makes itself: figures, and the reference of the settings."""

from __future__ import annotations

import hashlib
import importlib.util
import logging
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

from mdcs_pipeline.cli.options import range_text, type_text
from mdcs_pipeline.cli.stages import first_line, ports_of
from mdcs_pipeline.stage import stage_class, stage_names

DOCS = Path(__file__).parent
SETTINGS = "reference/settings.md"
_log = logging.getLogger("mkdocs.hooks.pages")


def on_pre_build(**_: Any) -> None:
    """Draw the figures, unless those there are of the same sources."""
    folder = DOCS / "figures"
    mark = folder / "sources.sha256"
    now = _digest()
    if mark.is_file() and mark.read_text() == now:
        return
    _log.info("drawing the figures; kernels that are not compiled yet take half a minute")
    spec = importlib.util.spec_from_file_location("figures", DOCS / "figures.py")
    assert spec is not None
    assert spec.loader is not None
    figures = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(figures)
    figures.draw_all(folder)
    mark.write_text(now)


def on_files(files: Files, config: Any) -> Files:
    """Add the page of the settings."""
    files.append(File.generated(config, SETTINGS, content=settings_page()))
    return files


def settings_page() -> str:
    """Return the reference of every installed stage's settings, in Markdown."""
    parts = [
        "# Settings of the stages",
        "Written from the stages themselves, as `mdcs options STAGE` prints them. A port with ? "
        "may stay unconnected, one with * collects several outputs.",
    ]
    for name in stage_names():
        parts.extend(_stage(name))
    return "\n\n".join(parts) + "\n"


def _stage(name: str) -> list[str]:
    stage = stage_class(name)
    fields = stage.Settings.model_fields
    head = [f"## {name}", first_line(stage), f"`{ports_of(stage)}`"]
    if not fields:
        return [*head, "No settings."]
    rows = ["| setting | type | default | range | meaning |", "| --- | --- | --- | --- | --- |"]
    for setting, info in fields.items():
        default = "required" if info.is_required() else f"`{info.get_default()!r}`"
        kind = type_text(info.annotation)
        cells = (f"`{setting}`", kind, default, range_text(info), info.description or "")
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return [*head, "\n".join(rows)]


def _digest() -> str:
    root = DOCS.parent
    paths = [p for name in ("mdcs_pipeline", "configs") for p in (root / name).rglob("*.*")]
    held = hashlib.sha256()
    for path in sorted([DOCS / "figures.py", *paths]):
        if path.suffix in (".py", ".yaml"):
            held.update(path.read_bytes())
    return held.hexdigest()
