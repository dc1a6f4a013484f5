"""What a stage is: frozen settings, and typed ports read off its call."""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoints, entry_points
from typing import Any, ClassVar, Generic, TypeVar, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, ValidationError

from mdcs_pipeline.errors import ConfigError, StageError, shorten, suggestion

ENTRY_POINT_GROUP = "mdcs_pipeline.stages"


class Settings(BaseModel):
    """Base of every stage's settings: frozen, validated, unknown names refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True)


SettingsT = TypeVar("SettingsT", bound=Settings)


@dataclass(frozen=True)
class Port:
    """One typed input or output of a stage.

    Parameters
    ----------
    name : str
    type : type
        Message that it takes or gives.
    optional : bool
        An input that may stay unconnected; an output that may stay silent.
    many : bool
        An input that collects from several outputs, in the order they are named.
    """

    name: str
    type: type
    optional: bool = False
    many: bool = False


class Stage(Generic[SettingsT]):
    """Base of every stage: settings in, messages to messages when called.

    A subclass names its `Settings` and defines ``__call__(self, port: Message, …)``
    that returns a NamedTuple with one field an output port. Annotations are the ports:
    ``X | None`` is optional, ``tuple[X, ...]`` collects several. A stage that takes a
    `PointCloud` passes it through `mdcs_pipeline.ingest.given_cloud`, so that scripts can
    call it on arrays and Open3D clouds as well.

    Parameters
    ----------
    settings : Settings, optional
        Validated settings; the defaults when absent.
    **values
        Single settings, over those of `settings`.

    Raises
    ------
    ConfigError
        If a setting is unknown or out of range.
    """

    Settings: ClassVar[type[Settings]] = Settings
    #: What the stage remembers from frame to frame, made without arguments; the runner owns it
    #: and passes it as ``state``. Stages of one graph that name the same class share it.
    State: ClassVar[type[Any] | None] = None
    settings: SettingsT
    __call__: Callable[..., Any]

    def __init__(self, settings: SettingsT | None = None, **values: Any) -> None:
        base = {} if settings is None else settings.model_dump()
        self.settings = validate_settings(type(self), {**base, **values})

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.settings!r})"


def validate_settings(stage: type[Stage[Any]], values: dict[str, Any]) -> Any:
    """Return the stage's settings made from `values`, or raise a `ConfigError`."""
    try:
        return stage.Settings.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            raise ConfigError(
                f"{stage.__name__} has no setting '{name}'",
                received=first["input"],
                remedy=suggestion(name, stage.Settings.model_fields),
            ) from error
        # A rule over several settings is broken by none of them in particular.
        subject = f"setting '{name}'" if name else f"settings of {stage.__name__}"
        raise ConfigError(
            f"{subject}: {first['msg'].lower()}",
            received=first.get("input"),
            remedy=setting_help(stage, name),
        ) from error


def setting_help(stage: type[Stage[Any]], name: str) -> str | None:
    """Return the documentation of one setting, if there is such a setting."""
    info = stage.Settings.model_fields.get(name.split(".")[0])
    return None if info is None else info.description


def _port(name: str, hint: Any) -> Port:
    if hint is Any or hint is inspect.Parameter.empty:
        raise StageError(f"port '{name}' needs a message type as its annotation")
    if get_origin(hint) in (Union, types.UnionType):
        rest = [part for part in get_args(hint) if part is not type(None)]
        if len(rest) != 1:
            raise StageError(f"port '{name}' may name one message type", received=shorten(hint))
        return Port(name, rest[0], optional=True)
    if get_origin(hint) is tuple:
        return Port(name, get_args(hint)[0], many=True)
    return Port(name, hint)


def input_ports(stage: type[Stage[Any]]) -> dict[str, Port]:
    """Return the input ports of a stage class, in the order of its call."""
    hints = get_type_hints(stage.__call__)
    names = list(inspect.signature(stage.__call__).parameters)[1:]
    if stage.State is not None:
        names.remove("state")
    return {name: _port(name, hints.get(name, Any)) for name in names}


def output_ports(stage: type[Stage[Any]]) -> dict[str, Port]:
    """Return the output ports of a stage class, in the order of its result."""
    result = get_type_hints(stage.__call__).get("return")
    if result is None or result is type(None):
        return {}
    if not hasattr(result, "_fields"):
        raise StageError(
            f"{stage.__name__} must return a NamedTuple with one field an output port",
            received=shorten(result),
        )
    hints = get_type_hints(result)
    return {name: _port(name, hints[name]) for name in result._fields}


def stage_entries() -> EntryPoints:
    """Return the entry points of all registered stages; every installed package is asked."""
    return entry_points(group=ENTRY_POINT_GROUP)


def stage_names() -> list[str]:
    """Return the names of all registered stages, sorted."""
    return sorted({entry.name for entry in stage_entries()})


def stage_class(name: str, entries: EntryPoints | None = None) -> type[Stage[Any]]:
    """Return the stage registered under `name`.

    Parameters
    ----------
    name : str
    entries : EntryPoints, optional
        What `stage_entries` gave, so that several stages need one search of what is installed.

    Raises
    ------
    ConfigError
        If there is none of that name, if two packages claim it, or if it does not load.
    """
    known = stage_entries() if entries is None else entries
    found = {entry.value: entry for entry in known.select(name=name)}
    if not found:
        raise ConfigError(f"unknown stage '{name}'", remedy=suggestion(name, stage_names()))
    if len(found) > 1:
        raise ConfigError(
            f"several packages register a stage '{name}'",
            received=", ".join(sorted(found)),
            remedy="uninstall all but one of them",
        )
    (entry,) = found.values()
    try:
        loaded = entry.load()
    except (ImportError, AttributeError) as error:
        raise ConfigError(
            f"stage '{name}' cannot be loaded", received=entry.value, remedy=str(error)
        ) from error
    if not (isinstance(loaded, type) and issubclass(loaded, Stage)):
        raise ConfigError(f"stage '{name}' is no Stage", received=entry.value)
    return loaded


def installed() -> dict[str, type[Stage[Any]]]:
    """Return all registered stages by name, sorted.

    Raises
    ------
    ConfigError
        As `stage_class`.
    """
    entries = stage_entries()
    return {name: stage_class(name, entries) for name in sorted(entries.names)}
