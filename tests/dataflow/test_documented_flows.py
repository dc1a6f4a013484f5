"""What README and docs/dora.md say to type is typed, and dora takes what comes of it."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

import pytest
import yaml
from flows import clouds, cut, dora, program, written

ROOT = Path(__file__).parents[2]
PAGES = ("README.md", "docs/dora.md")


def commands() -> list[list[str]]:
    """Return every line that exports or runs a flow, without where the program is installed."""
    found = []
    for page in PAGES:
        text = (ROOT / page).read_text().replace("\\\n", " ")
        for block in re.findall(r"^```\w*\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE):
            typed = [
                line for line in block.splitlines() if re.match(r"(\w+/bin/)?(mdcs|dora) ", line)
            ]
            lines = [shlex.split(line, comments=True) for line in typed]
            found += [[Path(words[0]).name, *words[1:]] for words in lines]
    return found


EXPORTS = [words for words in commands() if words[:3] == ["mdcs", "export", "dora"]]


@pytest.mark.parametrize("words", EXPORTS, ids=lambda words: " ".join(words[4:8]))
def test_what_is_exported_is_a_flow(words: list[str], tmp_path: Path) -> None:
    clouds(tmp_path / "frames", 2)
    cut(tmp_path, {"transport": "solver"}).rename(tmp_path / "my.yaml")
    done = subprocess.run(
        [program(words[0]), *words[1:]], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    if "--cloud" in words:
        # The camera is a node of the reader's own.
        (tmp_path / "camera.py").write_text("")
        flow = yaml.safe_load((tmp_path / "flow.yml").read_text())
        flow["nodes"].append({"id": "camera", "path": "camera.py", "outputs": ["points"]})
        (tmp_path / "flow.yml").write_text(yaml.safe_dump(flow, sort_keys=False))
    assert "wiring OK" in dora(tmp_path, "validate", "flow.yml")
    # Machines have daemons of their own: that is test_dora.py's.
    if "--frames" in words and "--machine" not in words:
        assert ["dora", "run", "flow.yml"] in commands()
        dora(tmp_path, "run", "flow.yml")
        assert len(written(tmp_path / "out")) == 2


def test_each_export_is_seen() -> None:
    assert len(EXPORTS) == 4
