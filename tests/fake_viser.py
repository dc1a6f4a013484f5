"""A server with viser's manners and no socket: what is shown can be read, controls pressed."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from mdcs_pipeline.viewer import page as page_module
from mdcs_pipeline.viewer.page import LivePage


class Handle:
    """A control or a thing in the scene: attributes, and callbacks when a user changes it."""

    def __init__(self, **held: Any) -> None:
        self.visible = True
        self.disabled = False
        self.__dict__.update(held)
        self.heard: list[Callable[[Any], None]] = []

    def on_update(self, call: Callable[[Any], None]) -> None:
        self.heard.append(call)

    on_click = on_update

    def by_user(self, value: Any = None, client: Any = "someone") -> None:
        """Do what a user does: set the value, or press."""
        if value is not None:
            self.value = value
        for call in self.heard:
            call(Handle(target=self, client=client))


class Gui:
    """Remembers every control by its label."""

    def __init__(self) -> None:
        self.by_label: dict[str, Handle] = {}
        self.texts: list[Handle] = []
        self.main_panel = Handle(dock_right=lambda: None)

    def configure_theme(self, **_: Any) -> None: ...

    def add_markdown(self, content: str, visible: bool = True) -> Handle:
        self.texts.append(Handle(content=content, visible=visible))
        return self.texts[-1]

    def add_slider(
        self, label: str, low: float, high: float, step: float, value: float, **more: Any
    ) -> Handle:
        assert low <= value <= high
        assert step > 0
        return self._add(label, min=low, max=high, value=value, **more)

    def add_dropdown(self, label: str, options: tuple[str, ...], *, initial_value: str) -> Handle:
        assert initial_value in options
        return self._add(label, value=initial_value, options=options)

    def add_checkbox(self, label: str, value: bool) -> Handle:
        return self._add(label, value=value)

    def add_button(self, label: str, **more: Any) -> Handle:
        return self._add(label, label=label, **more)

    @contextlib.contextmanager
    def add_folder(self, label: str) -> Iterator[None]:
        yield

    def _add(self, name: str, **held: Any) -> Handle:
        self.by_label[name] = Handle(**held)
        return self.by_label[name]

    @property
    def written(self) -> str:
        """All that can be read beside the picture."""
        return "\n".join(text.content for text in self.texts if text.visible)


class Scene:
    """Remembers what stands in it by name."""

    def __init__(self) -> None:
        self.things: dict[str, Handle] = {}
        self.up: tuple[float, ...] = ()

    def configure_environment_map(self, hdri: None) -> None: ...

    def configure_default_lights(self, cast_shadow: bool) -> None: ...

    def add_light_ambient(self, name: str, intensity: float) -> None: ...

    def set_up_direction(self, up: tuple[float, ...]) -> None:
        self.up = up

    def add_point_cloud(self, name: str, points: Any, colors: Any, **more: Any) -> Handle:
        return self._add(name, points=points, colors=colors, **more)

    def add_batched_meshes_simple(
        self, name: str, vertices: Any, faces: Any, wxyzs: Any, positions: Any, **more: Any
    ) -> Handle:
        assert len(wxyzs) == len(positions) == len(more["batched_colors"])
        return self._add(name, wxyzs=wxyzs, positions=positions, **more)

    def get_handle_by_name(self, name: str) -> Handle | None:
        return self.things.get(name)

    def _add(self, name: str, **held: Any) -> Handle:
        held["remove"] = lambda: self.things.pop(name)
        self.things[name] = Handle(**held)
        return self.things[name]


class Client:
    """Someone who looks at the page."""

    def __init__(self) -> None:
        self.camera = Handle()
        self.files: dict[str, bytes] = {}

    def atomic(self) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext()

    def send_file_download(self, name: str, data: bytes, save_immediately: bool) -> None:
        assert save_immediately
        self.files[name] = data


class Server:
    """What `open_server` gives, as far as the page uses it."""

    def __init__(self) -> None:
        self.gui = Gui()
        self.scene = Scene()
        self.initial_camera = Handle()
        self.client = Client()
        self.stopped = False

    def atomic(self) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext()

    def get_clients(self) -> dict[int, Client]:
        return {0: self.client}

    def get_port(self) -> int:
        return 4711

    def stop(self) -> None:
        self.stopped = True


def closed_at_once(patch: pytest.MonkeyPatch, by_key: bool = True) -> list[LivePage]:
    """Let pages do without sockets; return those that are served, and end at once.

    By Ctrl-C of their user, or else by being closed.
    """
    pages: list[LivePage] = []

    def serve(page: LivePage) -> None:
        pages.append(page)
        if by_key:
            raise KeyboardInterrupt

    patch.setattr(page_module, "open_server", lambda host, port, title: Server())
    patch.setattr(LivePage, "serve", serve)
    return pages


def shown(page: LivePage) -> list[Any]:
    """Return the frames that a page holds."""
    return page._film._frames
