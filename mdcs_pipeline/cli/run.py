"""``mdcs run CONFIG -i IN -o OUT``: the main job."""

from __future__ import annotations

import json as json_module
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mdcs_pipeline.cli.common import SetOption, load_graph
from mdcs_pipeline.cli.compiling import NOTICE, kernels_cached
from mdcs_pipeline.cli.console import note, say
from mdcs_pipeline.cli.outputs import check_result, plan_outputs, result_name
from mdcs_pipeline.cli.progress import Reporter, Stopwatch, reporter
from mdcs_pipeline.cli.screen import HostOption, PortOption, Screen, open_screen

if TYPE_CHECKING:
    from mdcs_pipeline.cli.inputs import Frame
    from mdcs_pipeline.cli.report import Done
    from mdcs_pipeline.graph import Graph
    from mdcs_pipeline.messages import PointCloud
    from mdcs_pipeline.pipeline import Pipeline
    from mdcs_pipeline.skeleton import Skeleton

Inputs = Annotated[
    list[str] | None,
    typer.Option(
        "--input",
        "-i",
        metavar="[NAME=]FILE",
        show_default=False,
        help="Cloud file, or a folder of them as a sequence of frames; with several sources "
        "NAME=FILE for each.",
    ),
]
Outputs = Annotated[
    list[Path] | None,
    typer.Option(
        "--output",
        "-o",
        metavar="FILE",
        show_default=False,
        help="File to write, repeatable; the suffix names the format: .json, .ply, .graphml, "
        ".npz, .swc, .png, .html. For a folder of frames, a folder.",
    ),
]


def run(
    config: Annotated[
        str,
        typer.Argument(metavar="CONFIG", help="Name of a shipped configuration, or a YAML file."),
    ] = "default",
    inputs: Inputs = None,
    outputs: Outputs = None,
    sets: SetOption = None,
    style: Annotated[
        str,
        typer.Option(
            "--format", metavar="SUFFIX", help="Suffix of the files when a folder comes out."
        ),
    ] = "json",
    frame_id: Annotated[
        str,
        typer.Option(metavar="NAME", help="Coordinate frame of the cloud, copied to the skeleton."),
    ] = "",
    stamp_ns: Annotated[
        int, typer.Option(metavar="NUMBER", help="Time of measurement in nanoseconds.")
    ] = 0,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Say nothing but errors (and --json).")
    ] = False,
    json: Annotated[
        bool, typer.Option("--json", help="One JSON object on standard output, errors too.")
    ] = False,
    profile: Annotated[
        bool, typer.Option("--profile", help="Show where the time went, stage by stage.")
    ] = False,
    view: Annotated[
        bool, typer.Option("--view", help="Show it on a page in the browser, until Ctrl-C.")
    ] = False,
    host: HostOption = None,
    port: PortOption = None,
) -> None:
    """Run a configuration on a cloud and write its skeleton."""
    from mdcs_pipeline.cli.inputs import find_frames
    from mdcs_pipeline.cli.report import as_json, show_profile, show_summary
    from mdcs_pipeline.pipeline import Pipeline

    graph = load_graph(config, sets)
    frames = find_frames(inputs or [], graph)
    check_result(graph, bool(outputs))
    plan = plan_outputs(outputs or [], style, frames)
    watch = Stopwatch()
    done: list[Done] = []
    sequence = frames.folder is not None
    with open_screen(graph, view, host, port, quiet) as screen:
        announce(quiet)
        with reporter(quiet) as shown, Pipeline(graph, (shown, watch, screen)) as pipe:
            for frame in frames.frames:
                job = _Job(frame, plan[frame.label], stamp_ns, frame_id)
                done.append(job.run(pipe, shown, watch, screen))
        if json:
            say(json_module.dumps(as_json(graph.spec.name, done, sequence, profile)))
        elif not quiet:
            show_summary(done, sequence)
            if profile:
                show_profile(done)
            if not outputs and not view:
                note("nothing written: name a file with -o, or look at it with --view")
        screen.stay()


def announce(quiet: bool) -> None:
    """Say on one line that the kernels are about to be compiled, if they are."""
    if not quiet and not kernels_cached():
        note(NOTICE)


class _Job:
    """One frame on its way through the pipeline."""

    def __init__(self, frame: Frame, outputs: list[Path], stamp_ns: int, frame_id: str) -> None:
        self._frame = frame
        self._outputs = outputs
        self._header = (stamp_ns, frame_id)

    def run(self, pipe: Pipeline, shown: Reporter, watch: Stopwatch, screen: Screen) -> Done:
        from mdcs_pipeline.cli.report import Done

        began = time.perf_counter()
        watch.seconds = {}
        shown.frame(self._frame.label)
        files = self._frame.files
        clouds = self._read(pipe.graph)
        screen.cloud(self._frame.label or _names(files), clouds, self._read)
        record = pipe.run(**clouds)
        name = result_name(pipe.graph)
        skeleton: Skeleton | None = None if name is None else record.results[name]
        screen.skeleton(skeleton)
        for path in self._outputs:
            save(skeleton, path, list(clouds.values()), pipe)
        return Done(
            label=self._frame.label,
            inputs=files,
            points=sum(len(cloud) for cloud in clouds.values()),
            dropped=sum(cloud.dropped for cloud in clouds.values()),
            skeleton=skeleton,
            record=record,
            seconds=time.perf_counter() - began,
            outputs=self._outputs,
            firings=watch.seconds,
        )

    def _read(self, graph: Graph) -> dict[str, PointCloud]:
        from mdcs_pipeline.cli.inputs import read_cloud

        files = self._frame.files
        return {k: read_cloud(p, k, graph, *self._header) for k, p in files.items()}


def _names(files: dict[str, Path]) -> str:
    return " + ".join(path.name for path in files.values())


def save(skeleton: Any, path: Path, clouds: list[PointCloud], pipe: Pipeline) -> None:
    """Write one output, with the cloud behind it and every setting that made it."""
    import numpy as np

    from mdcs_pipeline.errors import OutputError
    from mdcs_pipeline.io.write import write_skeleton

    try:
        # Only ever the folder of a sequence; that of a file was checked to be there.
        path.parent.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(
            "the folder cannot be made", where=str(path.parent), received=str(error)
        ) from error
    cloud = np.concatenate([held.positions for held in clouds]) if clouds else None
    write_skeleton(skeleton, path, cloud=cloud, settings=pipe.graph.settings())
