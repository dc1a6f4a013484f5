"""Writing results: whole or not at all."""

from __future__ import annotations

from pathlib import Path


def write_whole(path: Path, text: str) -> None:
    """Write a file so that nobody ever finds half of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def put_between(path: Path, begin: str, end: str, content: str) -> None:
    """Put text, after a blank line, between two markers of a file.

    Raises
    ------
    ValueError
        If a marker is missing.
    """
    text = path.read_text(encoding="utf-8")
    if begin not in text or end not in text:
        raise ValueError(f"{path} lacks the markers {begin} and {end}")
    before, rest = text.split(begin, 1)
    after = rest.split(end, 1)[1]
    write_whole(path, f"{before}{begin}\n\n{content.strip()}\n{end}{after}")
