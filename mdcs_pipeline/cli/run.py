"""``mdcs run CONFIG -i IN -o OUT``: the main job."""

from __future__ import annotations

import json as json_module
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mdcs_pipeline.cli.common import SetOption, ThreadsOption, load_graph
from mdcs_pipeline.cli.compiling import NOTICE, kernels_cached
from mdcs_pipeline.cli.console import note, say
from mdcs_pipeline.cli.outputs import check_result, plan_outputs, result_name
from mdcs_pipeline.cli.progress import Reporter, Stopwatch, reporter
from mdcs_pipeline.cli.screen import HostOption, PortOption, Screen, open_screen

if TYPE_CHECKING:
    from mdcs_pipeline.cli.inputs import Frames
    from mdcs_pipeline.cli.report import Done
    from mdcs_pipeline.graph import Graph
    from mdcs_pipeline.io.bag_writer import BagWriter
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
        help="Cloud file, or a folder of them or a bag (.mcap, .db3, .bag, rosbag2 folder) as a "
        "sequence of frames; with several sources NAME=FILE for each.",
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
        ".npz, .swc, .png, .html; .mcap is a bag of clouds and skeletons. For a sequence of "
        "frames, a folder or an .mcap.",
    ),
]
Config = Annotated[
    str,
    typer.Argument(metavar="CONFIG", help="Name of a shipped configuration, or a YAML file."),
]
Style = Annotated[
    str,
    typer.Option("--format", metavar="SUFFIX", help="Suffix of the files when a folder comes out."),
]
Topic = Annotated[
    str | None,
    typer.Option(show_default=False, help="Topic of a bag; not needed where it is alone."),
]
FrameNumber = Annotated[
    int | None,
    typer.Option(show_default=False, help="Take one cloud of a bag, counted from 0."),
]
FrameId = Annotated[
    str,
    typer.Option(metavar="NAME", help="Coordinate frame of the cloud, copied to the skeleton."),
]
Stamp = Annotated[int, typer.Option(metavar="NUMBER", help="Time of measurement in nanoseconds.")]


def run(
    config: Config = "default",
    inputs: Inputs = None,
    outputs: Outputs = None,
    sets: SetOption = None,
    threads: ThreadsOption = None,
    style: Style = "json",
    topic: Topic = None,
    frame: FrameNumber = None,
    frame_id: FrameId = "",
    stamp_ns: Stamp = 0,
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
    from mdcs_pipeline.cli.bags import split_bags
    from mdcs_pipeline.cli.inputs import find_frames
    from mdcs_pipeline.cli.report import as_json, show_profile, show_summary
    from mdcs_pipeline.pipeline import Pipeline

    graph = load_graph(config, sets, threads)
    frames = find_frames(inputs or [], graph, topic, frame)
    check_result(graph, bool(outputs))
    bags, files = split_bags([path.expanduser() for path in outputs or []], frames)
    plan = plan_outputs(files, style, frames)
    watch = Stopwatch()
    sequence = frames.folder is not None
    with open_screen(graph, view, host, port, quiet) as screen:
        with opened(bags) as writers:
            work = _Work(frames, plan, writers, (stamp_ns, frame_id))
            announce(quiet)
            with reporter(quiet) as shown, Pipeline(graph, (shown, watch, screen)) as pipe:
                count = len(frames.frames)
                done = [work.run(k, pipe, shown, watch, screen) for k in range(count)]
        if json:
            say(json_module.dumps(as_json(graph.spec.name, done, sequence, profile)))
        elif not quiet:
            show_summary(done, sequence)
            if profile:
                show_profile(done)
            if not outputs and not view:
                note("nothing written: name a file with -o, or look at it with --view")
        screen.stay()


@contextmanager
def opened(paths: list[Path]) -> Iterator[list[BagWriter]]:
    """Hold the bags of the result open, to be in place when all frames are done."""
    if not paths:
        yield []
        return
    from mdcs_pipeline.io.bag_writer import BagWriter

    with ExitStack() as stack:
        yield [stack.enter_context(BagWriter(path)) for path in paths]


def announce(quiet: bool) -> None:
    """Say on one line that the kernels are about to be compiled, if they are."""
    if not quiet and not kernels_cached():
        note(NOTICE)


class _Work:
    """Frames on their way through the pipeline, and where their results go."""

    def __init__(
        self,
        frames: Frames,
        outputs: dict[str, list[Path]],
        bags: list[BagWriter],
        header: tuple[int, str],
    ) -> None:
        self._frames = frames
        self._outputs = outputs
        self._bags = bags
        self._header = header

    def run(
        self, number: int, pipe: Pipeline, shown: Reporter, watch: Stopwatch, screen: Screen
    ) -> Done:
        from mdcs_pipeline.cli.bags import add_result
        from mdcs_pipeline.cli.inputs import read_clouds
        from mdcs_pipeline.cli.report import Done

        began = time.perf_counter()
        watch.seconds = {}
        frame = self._frames.frames[number]
        outputs = self._outputs[frame.label]
        shown.frame(frame.label)

        def read(graph: Graph) -> dict[str, PointCloud]:
            return read_clouds(frame, self._frames, graph, *self._header)

        clouds = read(pipe.graph)
        screen.cloud(frame.label or _names(frame.files), clouds, read)
        record = pipe.run(**clouds)
        name = result_name(pipe.graph)
        skeleton: Skeleton | None = None if name is None else record.results[name]
        screen.skeleton(skeleton)
        for path in outputs:
            save(skeleton, path, list(clouds.values()), pipe)
        if skeleton is not None:
            for bag in self._bags:
                add_result(bag, list(clouds.values()), skeleton, number)
        return Done(
            label=frame.label,
            inputs=frame.files,
            points=sum(len(cloud) for cloud in clouds.values()),
            dropped=sum(cloud.dropped for cloud in clouds.values()),
            skeleton=skeleton,
            record=record,
            seconds=time.perf_counter() - began,
            outputs=[*outputs, *(bag.path for bag in self._bags)],
            firings=watch.seconds,
        )


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
