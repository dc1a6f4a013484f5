"""``mdcs-dora``: one host of a graph, or its reader or writer, as a dora node.

`mdcs export dora` writes the dataflow that starts these. Messages are Arrow structs as
`mdcs_pipeline.wire` has them, and are read where dora's shared memory holds them.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mdcs_pipeline import wire
from mdcs_pipeline.checks import SOURCES
from mdcs_pipeline.config import load_spec, parse_override
from mdcs_pipeline.errors import InputError, MdcsError, MissingExtraError
from mdcs_pipeline.graph import build_graph
from mdcs_pipeline.io.arrow import arrow
from mdcs_pipeline.messages import PointCloud
from mdcs_pipeline.parts.dataflow import NEXT, TURN, WRITTEN, channel_id
from mdcs_pipeline.parts.letters import Letter, head_text
from mdcs_pipeline.pipeline import RESULT
from mdcs_pipeline.skeleton import Skeleton

from .member import Given, Member, opened

HEAD = "mdcs"
TICK_SECONDS = 0.5


def main(argv: Sequence[str] | None = None) -> int:
    """Run one node of a dataflow until its inputs end; return the exit code."""
    chosen = _parser().parse_args(argv)
    try:
        return int(chosen.run(chosen))
    except MdcsError as error:
        print(f"error: {error}", file=sys.stderr, flush=True)
        return error.exit_code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="mdcs-dora", description="A node of a dora dataflow that mdcs export dora wrote."
    )
    kinds = parser.add_subparsers(required=True)
    part = kinds.add_parser("part", help="run the stages of one host")
    part.add_argument("config")
    part.add_argument("--host", required=True)
    part.add_argument("--set", dest="sets", action="append", default=[])
    part.add_argument("--in-flight", type=int, default=1)
    part.add_argument("--waiting", type=int, default=16)
    part.add_argument("--acknowledged", action="store_true", help="results are acknowledged")
    part.set_defaults(run=_run_part)
    read = kinds.add_parser("read", help="read clouds and send each when it is asked for")
    read.add_argument("path", type=Path)
    read.set_defaults(run=_run_reader)
    write = kinds.add_parser("write", help="write each skeleton into a folder")
    write.add_argument("folder", type=Path)
    write.set_defaults(run=_run_writer)
    return parser


def _dora_node() -> Any:
    try:
        from dora import Node
    except ImportError as error:
        raise MissingExtraError(
            "a dora node needs dora-rs",
            received=str(error),
            remedy="install the extra: pip install 'mdcs-pipeline[dora]'",
        ) from error
    return Node()


def events_of(node: Any) -> Iterator[dict[str, Any] | None]:
    """Yield the events of a dora node until it is to stop, and None every half second."""
    while True:
        event = node.next(timeout=TICK_SECONDS)
        if event is None or event["type"] == "STOP":
            return
        if event["type"] != "ERROR":
            yield event
        elif str(event.get("error", "")).startswith("Timeout"):
            yield None
        else:
            raise InputError("dora reports an error", received=str(event.get("error")))


class PartNode:
    """One host of a graph as a dora node.

    Parameters
    ----------
    chosen : argparse.Namespace
        Of ``mdcs-dora part``.
    """

    def __init__(self, chosen: argparse.Namespace) -> None:
        self._none = arrow().array([], arrow().int8())
        graph = build_graph(load_spec(chosen.config, dict(map(parse_override, chosen.sets))))
        self._sources = list(graph.spec.sources)
        self._member = Member(
            graph,
            chosen.host,
            self._send,
            self._publish,
            _tell,
            chosen.waiting,
            in_flight=chosen.in_flight,
        )
        self._layout = self._member.part.layout
        self._is_entry = chosen.host == self._layout.entry
        # While one of these is open, more is to come.
        self._open = {f"{TURN}_{self._layout.entry}"}
        if self._is_entry:
            self._open = {f"{SOURCES}.{name}" for name in self._sources}
        self._held: dict[str, PointCloud] = {}
        self._asked = 0
        self._in_flight = chosen.in_flight
        self._acknowledged, self._unwritten = chosen.acknowledged, 0
        # Last: what dora brings from here on has to be taken soon, or it may be dropped.
        self._node = _dora_node()

    def run(self) -> int:
        """Take events until the clouds have ended, or the entry has."""
        self._tick()
        for event in events_of(self._node):
            if time.monotonic() - self._ticked > TICK_SECONDS:
                self._tick()
            if event is not None and event["type"] == "INPUT":
                self._take(event)
            elif event is not None and event["type"] == "INPUT_CLOSED":
                self._open.discard(event["id"])
            self._ask()
            # What nobody has taken yet would go with the one who sent it.
            if not self._open and self._member.idle and not self._unwritten:
                break
        if self._is_entry:
            counts = self._member.counts
            print(
                f"clouds {counts.offered}, done {counts.done}, failed {counts.failed}, "
                f"dropped {counts.replaced}",
                flush=True,
            )
        return 0

    def _tick(self) -> None:
        self._ticked = time.monotonic()
        self._send(self._member.part.hello())
        self._member.tick()
        self._ask()

    def _take(self, event: dict[str, Any]) -> None:
        name, head = event["id"], event["metadata"].get(HEAD)
        if name == WRITTEN:
            self._unwritten -= 1
            return
        try:
            if head is not None:
                self._member.receive(opened(self._member.part, head, event["value"]))
            else:
                self._gather(name.removeprefix(SOURCES + "."), cloud_of(event))
        except InputError as error:
            _tell(error.located(f"input '{name}'"))

    def _gather(self, source: str, cloud: PointCloud) -> None:
        """Begin a frame once there is a cloud of each source."""
        self._held[source] = cloud
        if len(self._held) == len(self._sources):
            clouds, self._held = self._held, {}
            header = clouds[self._sources[0]].header
            self._member.offer(Given(clouds, header.stamp_ns, header.frame_id))

    def _ask(self) -> None:
        """Ask whoever reads files for as many clouds as can be under way."""
        if not self._is_entry:
            return
        counts = self._member.counts
        over = counts.done + counts.failed + counts.replaced
        while self._asked < over + self._in_flight:
            self._asked += 1
            self._node.send_output(NEXT, self._none)

    def _send(self, letter: Letter) -> None:
        output = channel_id(letter.key[:2]) if letter.kind == "value" else TURN
        if output == TURN and len(self._layout.hosts) == 1:
            return
        held = self._none if letter.message is None else wire.to_arrow(letter.message)
        self._node.send_output(output, held, {HEAD: head_text(letter)})

    def _publish(self, skeleton: Skeleton) -> None:
        self._node.send_output(RESULT, wire.to_arrow(skeleton))
        self._unwritten += self._acknowledged


def cloud_of(event: dict[str, Any]) -> PointCloud:
    """Return the cloud of an input: a `PointCloud` struct, or coordinates one after another.

    Raises
    ------
    InputError
        If it is neither.
    """
    import numpy as np

    from mdcs_pipeline.header import Header
    from mdcs_pipeline.ingest import as_point_cloud

    pa, value, metadata = arrow(), event["value"], event["metadata"]
    if pa.types.is_struct(value.type):
        return wire.from_arrow(value, PointCloud)
    if pa.types.is_fixed_size_list(value.type):
        value = value.flatten()
    kind = value.type
    if not (pa.types.is_floating(kind) or pa.types.is_integer(kind)) or len(value) % 3:
        raise InputError(
            "the input is no cloud",
            received=f"{len(value)} values of {kind}",
            remedy="send a PointCloud struct (docs/wire.md) or x, y, z of each point in a row",
        )
    points = np.asarray(value.to_numpy(zero_copy_only=False)).reshape(-1, 3)
    stamp_ns, frame_id = int(metadata.get("stamp_ns", 0)), str(metadata.get("frame_id", ""))
    return as_point_cloud(points, Header(frame_id, stamp_ns))


def _tell(error: Exception) -> None:
    print(f"warning: {error}", file=sys.stderr, flush=True)


def _run_part(chosen: argparse.Namespace) -> int:
    return PartNode(chosen).run()


def _run_reader(chosen: argparse.Namespace) -> int:
    from mdcs_pipeline.io.clouds import frame_files

    files = frame_files(chosen.path) if chosen.path.is_dir() else [chosen.path]
    node = _dora_node()
    waiting = _readable(files)
    for event in events_of(node):
        if event is None or event["type"] != "INPUT":
            continue
        cloud = next(waiting, None)
        if cloud is None:
            break
        node.send_output("cloud", wire.to_arrow(cloud))
    return 0


def _readable(files: Sequence[Path]) -> Iterator[PointCloud]:
    """Yield the clouds of files; one that cannot be read is told of and left out."""
    from mdcs_pipeline.header import Header
    from mdcs_pipeline.ingest import as_point_cloud
    from mdcs_pipeline.io.clouds import read_points

    for file in files:
        try:
            yield as_point_cloud(read_points(file), Header())
        except MdcsError as error:
            _tell(error.located(str(file)))


def _run_writer(chosen: argparse.Namespace) -> int:
    from mdcs_pipeline.io.write import write_skeleton

    chosen.folder.mkdir(parents=True, exist_ok=True)
    node, none = _dora_node(), arrow().array([], arrow().int8())
    for event in events_of(node):
        if event is not None and event["type"] == "INPUT":
            try:
                skeleton = wire.from_arrow(event["value"], Skeleton)
                write_skeleton(skeleton, chosen.folder / f"{skeleton.header.seq:06d}.json")
            finally:
                node.send_output(WRITTEN, none)
    return 0


if __name__ == "__main__":
    sys.exit(main())
