"""What ``-o`` names: files for the skeletons, checked before any work is done."""

from __future__ import annotations

import os
from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from mdcs_pipeline.cli.common import check_folder, check_output, check_suffix
from mdcs_pipeline.errors import ConfigError, MissingExtraError, OutputError

if TYPE_CHECKING:
    from mdcs_pipeline.cli.inputs import Frame, Frames
    from mdcs_pipeline.graph import Graph

_NEEDS = {".png": "matplotlib", ".html": "k3d"}


def result_name(graph: Graph) -> str | None:
    """Return the result that is the pipeline's skeleton, if there is one."""
    from mdcs_pipeline.checks import find_output
    from mdcs_pipeline.pipeline import RESULT
    from mdcs_pipeline.skeleton import Skeleton

    results = graph.spec.results
    name = RESULT if RESULT in results else next(iter(results)) if len(results) == 1 else None
    if name is None:
        return None
    _, port = find_output(results[name], graph.spec, graph.ports, name)
    return name if isinstance(port.type, type) and issubclass(port.type, Skeleton) else None


def plan_outputs(outputs: Iterable[Path], style: str, frames: Frames) -> dict[str, list[Path]]:
    """Return the files to write by the label of their frame, all of them possible to write.

    Parameters
    ----------
    outputs : iterable of Path
        Files, or folders where a folder went in.
    style : str
        Suffix of the files in a folder, with or without its dot.
    frames : Frames

    Raises
    ------
    OutputError
        If one of them cannot be written, is named twice or is an input.
    MissingExtraError
        If a format needs a package that is not installed.
    """
    from mdcs_pipeline.io.write import SKELETON_SUFFIXES

    given = [path.expanduser() for path in outputs]
    suffix = f".{style.lstrip('.').lower()}"
    if frames.folder is None:
        plan = {frame.label: given for frame in frames.frames}
        for path in given:
            check_output(path, SKELETON_SUFFIXES)
            check_extra(path)
    else:
        check_suffix(Path(f"--format {suffix}"), SKELETON_SUFFIXES)
        check_extra(Path(f"frame{suffix}"))
        for folder in given:
            _check_place(folder)
        names = {frame.label: _file_name(frame, frames) + suffix for frame in frames.frames}
        plan = {label: [folder / name for folder in given] for label, name in names.items()}
    _check_distinct([p for paths in plan.values() for p in paths], frames)
    return plan


def _file_name(frame: Frame, frames: Frames) -> str:
    (path,) = frame.files.values()
    if frame.number is not None:
        return frame.label
    stems = [Path(other.label).stem for other in frames.frames]
    # a.ply and a.pcd in one folder keep their suffixes, or one would overwrite the other.
    return path.stem if stems.count(path.stem) == 1 else path.name


def _check_place(folder: Path) -> None:
    if folder.is_dir():
        check_folder(folder, folder)
    elif folder.exists():
        raise OutputError(
            "a folder went in, so a folder must come out; this is a file",
            where=str(folder),
            remedy="name a folder; --format chooses the suffix of its files",
        )
    else:
        check_folder(folder.parent, folder)


def check_extra(path: Path) -> None:
    """Refuse a format whose package is not installed."""
    module = _NEEDS.get(path.suffix.lower())
    if module is not None and find_spec(module) is None:
        raise MissingExtraError(
            f"a file of the format '{path.suffix}' needs {module}",
            where=str(path),
            remedy="pip install 'mdcs-pipeline[draw]'",
        )


def _check_distinct(paths: list[Path], frames: Frames) -> None:
    inputs = {os.path.realpath(p) for frame in frames.frames for p in frame.files.values()}
    seen: set[str] = set()
    for path in paths:
        real = os.path.realpath(path)
        if real in inputs:
            raise OutputError(
                "the output would overwrite the input",
                where=str(path),
                remedy="choose another name",
            )
        if real in seen:
            raise OutputError(
                "the same output twice", where=str(path), remedy="name each output once"
            )
        seen.add(real)


def check_result(graph: Graph, wanted: bool) -> None:
    """Refuse outputs of a pipeline from which no skeleton comes."""
    if wanted and result_name(graph) is None:
        raise ConfigError(
            "the pipeline gives no skeleton that could be written",
            where=graph.spec.file,
            received=", ".join(graph.spec.results) or "no results",
            remedy="call the output that is one 'skeleton' under results, or leave out -o",
        )
