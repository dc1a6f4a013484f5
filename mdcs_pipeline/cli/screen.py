"""``--view``: what a run shows on a live page, if one was asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from mdcs_pipeline.cli.console import note
from mdcs_pipeline.errors import InputError
from mdcs_pipeline.hooks import Hook

if TYPE_CHECKING:
    from mdcs_pipeline.graph import Graph
    from mdcs_pipeline.messages import PointCloud
    from mdcs_pipeline.skeleton import Skeleton
    from mdcs_pipeline.viewer.film import Frame
    from mdcs_pipeline.viewer.page import LivePage

HostOption = Annotated[
    str | None,
    typer.Option(
        "--host",
        metavar="ADDRESS",
        show_default=False,
        help="Where the page listens: 127.0.0.1, this machine alone, unless given.",
    ),
]
PortOption = Annotated[
    int | None,
    typer.Option(
        "--port",
        metavar="NUMBER",
        min=0,
        max=65535,
        show_default=False,
        help="Port of the page; 8080 or the next free one unless given, 0 for any.",
    ),
]


class Screen(Hook):
    """Where a run shows its frames; this one shows nothing."""

    def cloud(
        self,
        label: str,
        clouds: Mapping[str, PointCloud],
        read: Callable[[Graph], Mapping[str, PointCloud]] | None = None,
    ) -> None:
        """Hear which clouds come next, and how to read them again where that is possible."""

    def skeleton(self, skeleton: Skeleton | None) -> None:
        """Hear what came of the clouds."""

    def stay(self) -> None:
        """Wait until the user has seen enough."""


class PageScreen(Screen):
    """A screen that is a live page."""

    def __init__(self, page: LivePage, graph: Graph, quiet: bool) -> None:
        from mdcs_pipeline.viewer.film import Frame

        self._page = page
        self._graph = graph
        self._quiet = quiet
        self._frame: Frame = Frame()

    def cloud(
        self,
        label: str,
        clouds: Mapping[str, PointCloud],
        read: Callable[[Graph], Mapping[str, PointCloud]] | None = None,
    ) -> None:
        """Show the cloud while its skeleton is being made."""
        import numpy as np

        from mdcs_pipeline.cli.outputs import result_name
        from mdcs_pipeline.viewer.film import Frame
        from mdcs_pipeline.viewer.remake import remaker

        points = np.concatenate([cloud.positions for cloud in clouds.values()]) if clouds else None
        frame = Frame(label, points)
        name = result_name(self._graph)
        if name is not None and read is not None:
            # Without the cloud, of which the page keeps no more than it draws.
            again = remaker(self._graph, name, Frame(label), read)
            frame = replace(frame, again=again)
        self._frame = replace(frame, settings=self._graph.settings())
        self._page.show(self._frame)

    def stage_started(self, name: str, firing: int) -> None:
        """Write which stage is at work."""
        self._page.say(f"{name}, round {firing} …")

    def skeleton(self, skeleton: Skeleton | None) -> None:
        """Add the skeleton to the cloud."""
        self._page.amend(replace(self._frame, skeleton=skeleton))

    def stay(self) -> None:
        """Serve the page until Ctrl-C, which is how it is meant to end."""
        self._page.finish()
        stay(self._page, self._quiet)


def stay(page: LivePage, quiet: bool) -> None:
    """Serve a page until Ctrl-C."""
    try:
        # Within the try: who reads this line may press Ctrl-C before the next one.
        if not quiet:
            note(f"the page stays at {page.url} until Ctrl-C")
        page.serve()
    except KeyboardInterrupt:
        if not quiet:
            note("page closed")


def page_wanted(view: bool, host: str | None, port: int | None) -> bool:
    """Return whether a page was asked for; an address without one is an `InputError`."""
    if not view and (host is not None or port is not None):
        raise InputError("--host and --port are of the page", remedy="add --view")
    return view


@contextmanager
def open_screen(
    graph: Graph, view: bool, host: str | None, port: int | None, quiet: bool
) -> Iterator[Screen]:
    """Give the screen that was asked for, and take it down in the end.

    Raises
    ------
    InputError
        If an address is given but no page wanted, or nobody can listen there.
    MissingExtraError
        If viser is not installed.
    """
    if not page_wanted(view, host, port):
        yield Screen()
        return
    from mdcs_pipeline.viewer.remake import epsilon_dial

    with open_page(graph.spec.name, host, port, quiet, epsilon_dial(graph)) as page:
        yield PageScreen(page, graph, quiet)


@contextmanager
def open_page(
    title: str, host: str | None, port: int | None, quiet: bool, dial: object = None
) -> Iterator[LivePage]:
    """Give a live page after telling where it is."""
    from mdcs_pipeline.viewer.film import Dial
    from mdcs_pipeline.viewer.page import LivePage
    from mdcs_pipeline.viewer.server import LOCAL_HOST, is_local

    held = dial if isinstance(dial, Dial) else None
    with LivePage(host or LOCAL_HOST, port, held, f"mdcs: {title}") as page:
        if not quiet:
            note(f"page: {page.url}")
            if host is not None and not is_local(host):
                note("whoever reaches this machine can look at it, without a password", "yellow")
        yield page
