"""Build the wheel and the sdist, and use both as somebody does who has no checkout.

``python tests/package_check.py`` makes an environment for every Python that the package
declares and this machine has, installs the wheel into it, and does there what README says.
The first of them gets the sdist instead, and one more environment the wheel with the oldest
versions of what it depends on. It ends with 1 if anything fails.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from concurrent.futures import ThreadPoolExecutor
from email.parser import Parser
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGES = {"mdcs_pipeline": "mdcs_pipeline", "nodes": "mdcs_pipeline/nodes"}
PACKAGES["configs"] = "mdcs_pipeline/configs"

# What is done in every environment, far from the checkout.
USE = """
import json, pathlib, subprocess, sys
from importlib.metadata import version
from importlib.resources import files
import numpy as np
import mdcs_pipeline as mdcs
from mdcs_pipeline.demo import demo_cloud

place = pathlib.Path(mdcs.__file__)
assert "site-packages" in place.parts, place
assert files("mdcs_pipeline").joinpath("py.typed").is_file()
command = pathlib.Path(sys.executable).with_name("mdcs")

def run(*words, code=0):
    done = subprocess.run([command, *words], capture_output=True, text=True)
    assert done.returncode == code, (words, done.returncode, done.stdout, done.stderr)
    assert "Traceback" not in done.stderr, done.stderr
    return done.stdout + done.stderr

assert run("--version").split() == ["mdcs-pipeline", version("mdcs-pipeline")]
assert mdcs.__version__ == version("mdcs-pipeline")
for name in ("default", "paper"):
    assert name in run("configs")
    assert "valid" in run("validate", name)
assert "transport" in run("stages")
np.save("cloud.npy", demo_cloud(1000))
run("run", "paper", "-i", "cloud.npy", "-o", "s.json")
assert json.loads(run("info", "s.json", "--format", "json"))["summary"]["nodes"] > 5
# Without an extra, what needs it says which one.
pathlib.Path("a.ply").write_text("ply\\nformat ascii 1.0\\nelement vertex 1\\nproperty float x\\n"
    "property float y\\nproperty float z\\nend_header\\n0 0 0\\n")
pathlib.Path("a.mcap").write_bytes(b"x")
assert "[open3d-cpu]" in run("run", "paper", "-i", "a.ply", code=2)
assert "[bags]" in run("run", "paper", "-i", "a.mcap", code=2)
assert "[draw]" in run("run", "paper", "-i", "cloud.npy", "-o", "s.png", code=2)
"""


def main() -> int:
    """Build, look at what was built, and use it; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        wheel, sdist = build(work)
        look(wheel, sdist)
        found = {version: python_of(version) for version in declared(wheel)}
        for version, python in found.items():
            if python is None:
                print(f"Python {version}: not on this machine, not checked", flush=True)
        present = {v: p for v, p in found.items() if p is not None}
        with ThreadPoolExecutor(given.jobs) as pool:
            jobs = [
                pool.submit(use, version, python, wheel if number else sdist, work)
                for number, (version, python) in enumerate(present.items())
            ]
            version, python = next(iter(present.items()))
            name = f"{version} with the oldest dependencies"
            jobs.append(pool.submit(use, name, python, wheel, work, oldest(wheel)))
            good = [job.result() for job in jobs]
    print(f"{sum(good)} passed, {len(good) - sum(good)} failed", flush=True)
    return 0 if good and all(good) else 1


def build(work: Path) -> tuple[Path, Path]:
    """Return a wheel and an sdist; the wheel is built from the sdist, not from here."""
    command = [sys.executable, "-m", "build", "--outdir", work / "dist", ROOT]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"the package cannot be built\n{done.stdout}{done.stderr}")
    (wheel,), (sdist,) = ((work / "dist").glob(f"*{end}") for end in (".whl", ".tar.gz"))
    subprocess.run([sys.executable, "-m", "twine", "check", "--strict", wheel, sdist], check=True)
    return wheel, sdist


def look(wheel: Path, sdist: Path) -> None:
    """Raise if a module, a configuration or a piece of the metadata is missing."""
    with zipfile.ZipFile(wheel) as held:
        inside = set(held.namelist())
    fields = Parser().parsestr(metadata(wheel))
    wanted = {
        f"{target}/{path.relative_to(ROOT / source)}"
        for source, target in PACKAGES.items()
        for path in (ROOT / source).rglob("*")
        if path.suffix in (".py", ".yaml", ".json", ".typed") and "__pycache__" not in path.parts
    }
    assert wanted <= inside, f"the wheel lacks {sorted(wanted - inside)}"
    strangers = {n for n in inside - wanted if ".dist-info/" not in n}
    assert not strangers, f"the wheel holds {sorted(strangers)}"
    for name in ("Summary", "Author", "License-Expression", "Keywords", "Requires-Python"):
        assert fields[name], f"the metadata have no {name}"
    with tarfile.open(sdist) as held:
        names = {name.partition("/")[2] for name in held.getnames()}
    for name in ("CHANGELOG.md", "LICENSE", "Makefile", "tests/shapes.py", "docs/images/demo.png"):
        assert name in names, f"the sdist lacks {name}"


def declared(wheel: Path) -> list[str]:
    """Return the versions of Python that the metadata name."""
    pattern = r"^Classifier: Programming Language :: Python :: (3\.\d+)$"
    return re.findall(pattern, metadata(wheel), re.MULTILINE)


def oldest(wheel: Path) -> str:
    """Return, for pip, the lowest version of each dependency that the metadata allow."""
    found = re.findall(r"^Requires-Dist: ([\w-]+)>=([\d.]+)$", metadata(wheel), re.MULTILINE)
    assert found, "no dependency has a lower bound"
    return "".join(f"{name}=={version}\n" for name, version in found)


def metadata(wheel: Path) -> str:
    """Return the text of a wheel's metadata."""
    with zipfile.ZipFile(wheel) as held:
        name = next(n for n in held.namelist() if n.endswith(".dist-info/METADATA"))
        return held.read(name).decode()


def python_of(version: str) -> Path | None:
    """Return an interpreter of a version, of the system or of pyenv."""
    held = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))
    on_path = shutil.which(f"python{version}")
    for path in [*held, *([Path(on_path)] if on_path else [])]:
        # pyenv puts a name on the path for versions too that it will not run.
        asked = "import sys, venv, ensurepip; print('%d.%d' % sys.version_info[:2])"
        done = subprocess.run([path, "-c", asked], capture_output=True, text=True, check=False)
        if done.stdout.strip() == version:
            return path
    return None


def use(version: str, python: Path, built: Path, work: Path, constraints: str = "") -> bool:
    """Return whether what was built works in an environment of its own."""
    folder = work / version
    pins = work / f"{version}.txt"
    pins.write_text(constraints, encoding="utf-8")
    steps: list[list[str | Path]] = [
        [python, "-m", "venv", folder / "venv"],
        [folder / "venv/bin/python", "-m", "pip", "install", "-q", "-c", pins, built],
        [folder / "venv/bin/python", "-m", "pip", "check"],
        [folder / "venv/bin/python", "-I", "-c", USE],
    ]
    folder.mkdir()
    for step in steps:
        done = subprocess.run(step, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode:
            print(f"Python {version}, {built.name}: failed\n{done.stdout}{done.stderr}", flush=True)
            return False
    print(f"Python {version}, {built.name}: works", flush=True)
    return True


if __name__ == "__main__":
    sys.exit(main())
