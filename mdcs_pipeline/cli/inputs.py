"""What ``-i`` names: clouds for the sources of a pipeline, frame by frame."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mdcs_pipeline.errors import InputError, suggestion

if TYPE_CHECKING:
    from mdcs_pipeline.cli.bags import BagCursor
    from mdcs_pipeline.graph import Graph
    from mdcs_pipeline.messages import PointCloud


@dataclass(frozen=True)
class Frame:
    """The files of one frame, by source; `number` is that of a cloud within a bag."""

    label: str
    files: dict[str, Path]
    number: int | None = None


@dataclass(frozen=True)
class Frames:
    """All that is to be run; `folder` tells a sequence, even of one, from a single cloud.

    It is the folder or bag of the sequence. `bag` gives the clouds of a bag.
    """

    frames: tuple[Frame, ...]
    folder: Path | None = None
    bag: BagCursor | None = None


def find_frames(
    given: list[str], graph: Graph, topic: str | None = None, number: int | None = None
) -> Frames:
    """Return the frames that ``-i`` asks for, before any cloud is read.

    `topic` and `number` choose among the clouds of a bag.

    Raises
    ------
    InputError
        If the sources of the pipeline are not the ones given, a folder or bag holds no such
        cloud, or a topic is named where there is no bag.
    """
    from mdcs_pipeline.io.bags import is_bag
    from mdcs_pipeline.io.clouds import frame_files
    from mdcs_pipeline.runner import check_sources

    named = by_source(given, list(graph.spec.sources))
    if not given and graph.spec.sources:
        raise InputError(
            "no cloud was given",
            where=f"pipeline '{graph.spec.name}'",
            remedy="add -i FILE, or -i FOLDER for a sequence of frames"
            if len(graph.spec.sources) == 1
            else "add " + " ".join(f"-i {source}=FILE" for source in graph.spec.sources),
        )
    check_sources(named, graph)
    bags = {name: path for name, path in named.items() if is_bag(path)}
    if not bags and (topic is not None or number is not None):
        raise InputError(
            "--topic and --frame are for bags",
            received=", ".join(given) or "no input",
            remedy="leave them out, or name a bag: a rosbag2 folder, .mcap, .db3 or .bag",
        )
    folders = bags | {name: path for name, path in named.items() if path.is_dir()}
    if not folders:
        return Frames((Frame("", named),))
    if len(named) > 1:
        name, path = next(iter(folders.items()))
        raise InputError(
            "a sequence of frames goes with one source only",
            where=f"source '{name}'",
            received=str(path),
            remedy="give a file for each source, and run once a frame",
        )
    ((name, folder),) = folders.items()
    if bags:
        from mdcs_pipeline.cli.bags import bag_frames

        return bag_frames(folder, name, topic, number)
    files = frame_files(folder)
    return Frames(tuple(Frame(p.name, {name: p}) for p in files), folder)


def by_source(given: list[str], sources: list[str]) -> dict[str, Path]:
    """Return paths by source: from ``NAME=FILE``, or from a file for the only source."""
    found: dict[str, Path] = {}
    for text in given:
        name, path = _split(text, sources)
        if name in found:
            raise InputError(
                f"the source '{name}' is given twice",
                received=text,
                remedy="one file or folder for each source: "
                + ", ".join(f"-i {source}=FILE" for source in sources),
            )
        found[name] = path
    return found


def _split(text: str, sources: list[str]) -> tuple[str, Path]:
    name, equals, rest = text.partition("=")
    # A file of that very name is meant before a source is.
    if equals and re.fullmatch(r"[A-Za-z_][\w-]*", name) and not Path(text).exists():
        if name not in sources:
            raise InputError(
                f"the pipeline has no source '{name}'",
                received=text,
                remedy=suggestion(name, sources),
            )
        return name, Path(rest).expanduser()
    if len(sources) == 1:
        return sources[0], Path(text).expanduser()
    raise InputError(
        f"the pipeline has {len(sources)} sources",
        received=text,
        remedy="name them: " + " ".join(f"-i {source}=FILE" for source in sources)
        if sources
        else "it takes its points from elsewhere: leave out -i",
    )


def read_clouds(
    frame: Frame, frames: Frames, graph: Graph, stamp_ns: int, frame_id: str
) -> dict[str, PointCloud]:
    """Return the clouds of a frame by source; errors name the file.

    Time and frame given on the command line go over those that a bag has.
    """
    if frames.bag is None or frame.number is None:
        return {k: read_cloud(p, k, graph, stamp_ns, frame_id) for k, p in frame.files.items()}
    from mdcs_pipeline.header import Header
    from mdcs_pipeline.ingest import as_point_cloud

    ((source, path),) = frame.files.items()
    held = frames.bag.take(frame.number)
    header = Header(frame_id or held.frame_id, stamp_ns or held.stamp_ns)
    try:
        cloud = as_point_cloud(held.points, header, graph.spec.sources[source].nonfinite)
    except InputError as error:
        raise error.located(f"{path}, message {frame.number}") from error
    return {source: cloud}


def read_cloud(path: Path, source: str, graph: Graph, stamp_ns: int, frame_id: str) -> PointCloud:
    """Return the cloud of a file; errors name the file."""
    from mdcs_pipeline.header import Header
    from mdcs_pipeline.ingest import as_point_cloud
    from mdcs_pipeline.io.clouds import read_points

    points = read_points(path)
    try:
        nonfinite = graph.spec.sources[source].nonfinite
        return as_point_cloud(points, Header(frame_id, stamp_ns), nonfinite)
    except InputError as error:
        raise error.located(str(path)) from error
