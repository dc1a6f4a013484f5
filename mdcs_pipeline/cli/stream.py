"""``mdcs stream CONFIG -i FOLDER|- -o OUT``: frames that add up to a scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mdcs_pipeline.cli.common import ConfigArgument, SetOption, ThreadsOption, load_graph
from mdcs_pipeline.cli.run import announce
from mdcs_pipeline.cli.screen import HostOption, PortOption

if TYPE_CHECKING:
    from mdcs_pipeline.cli.streaming import Job


Source = Annotated[
    str,
    typer.Option(
        "--input",
        "-i",
        metavar="FOLDER|BAG|-",
        show_default=False,
        help="Folder of cloud files, with poses.txt or poses.npy where there are poses; a bag of "
        "ROS; or - for frames from a pipe, lines of JSON or arrays of numpy.save.",
    ),
]
Outputs = Annotated[
    list[Path] | None,
    typer.Option(
        "--output",
        "-o",
        show_default=False,
        help="Repeatable: .jsonl gets a line for every frame's changes; any other suffix the "
        "skeleton at the end (.json, .ply, .graphml, .npz, .swc, .png, .html).",
    ),
]
Poses = Annotated[Path | None, typer.Option(help="File of poses, one a cloud, for a folder.")]
Topic = Annotated[str | None, typer.Option(help="Topic of the clouds in a bag.")]
PoseTopic = Annotated[str | None, typer.Option(help="Topic of the poses in a bag.")]
FrameId = Annotated[str, typer.Option(help="Coordinate frame, where the input names none.")]
Rate = Annotated[
    float | None,
    typer.Option(
        min=0.001,
        help="Frames a second: a folder is read at this pace, as if it were a sensor.",
    ),
]
Overload = Annotated[
    str,
    typer.Option(
        metavar="block|latest|queue:N",
        help="When frames come faster than they are done: the source waits, only the newest "
        "waits, or N wait and the oldest goes.",
    ),
]
Unusable = Annotated[
    str,
    typer.Option(
        metavar="drop|refuse", help="What to do with empty frames and the like: count, or end."
    ),
]
Checkpoint = Annotated[
    Path | None,
    typer.Option(help="File to save the scene to; where it exists, the run goes on from it."),
]
Every = Annotated[
    str, typer.Option(metavar="N|Ns", help="Save after N frames, or, with an s, N seconds.")
]

View = Annotated[
    bool,
    typer.Option(
        "--view",
        help="Show map and skeleton on a page in the browser, until Ctrl-C. Pausing there stops "
        "the reading of a folder or bag; a pipe goes on, and the picture alone stands still.",
    ),
]


def stream(
    config: ConfigArgument,
    source: Source,
    outputs: Outputs = None,
    sets: SetOption = None,
    threads: ThreadsOption = None,
    poses: Poses = None,
    topic: Topic = None,
    pose_topic: PoseTopic = None,
    frame_id: FrameId = "",
    rate: Rate = None,
    overload: Overload = "block",
    unusable: Unusable = "drop",
    checkpoint: Checkpoint = None,
    every: Every = "10",
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Only errors.")] = False,
    json: Annotated[
        bool, typer.Option("--json", help="Summary as JSON on standard output.")
    ] = False,
    view: View = False,
    host: HostOption = None,
    port: PortOption = None,
) -> None:
    """Keep the skeleton of a scene up with its frames."""
    from mdcs_pipeline.cli.stream_plan import Saving, open_source, plan_streamed
    from mdcs_pipeline.cli.stream_screen import open_stream_screen
    from mdcs_pipeline.cli.streaming import Job
    from mdcs_pipeline.overload import parse_policy
    from mdcs_pipeline.stream import Stream

    graph = load_graph(config, sets, threads)
    if unusable not in ("drop", "refuse"):
        raise typer.BadParameter("drop or refuse", param_hint="--unusable")
    job: Job = Job(
        stream=Stream(graph, unusable="drop" if unusable == "drop" else "refuse"),
        frames=open_source(source, poses, topic, pose_topic, frame_id, rate),
        outputs=plan_streamed(outputs or [], source),
        saving=Saving.parse(checkpoint, every),
        policy=parse_policy(overload),
        rate=rate,
        quiet=quiet or json,
    )
    waits = source != "-"
    with open_stream_screen(graph, job.frames, waits, view, host, port, quiet) as screen:
        job.screen = screen
        announce(quiet)
        job.run()
        job.tell(json, quiet)
        screen.stay()
