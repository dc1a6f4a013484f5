"""The description of a pipeline: YAML text to frozen, placed specifications."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from mdcs_pipeline.document import (
    Branch,
    Place,
    entries_of,
    known_keys,
    read_document,
    text_of,
)
from mdcs_pipeline.errors import ConfigError, suggestion
from mdcs_pipeline.overrides import override_spec, parse_override
from mdcs_pipeline.spec import (
    MAIN_HOST,
    FeedbackSpec,
    PipelineSpec,
    Ref,
    SourceSpec,
    StageSpec,
    checked_nonfinite,
    checked_threads,
)

__all__ = [
    "FeedbackSpec",
    "PipelineSpec",
    "Place",
    "Ref",
    "SourceSpec",
    "StageSpec",
    "config_names",
    "load_spec",
    "override_spec",
    "parse_override",
    "parse_spec",
]

PIPELINE_KEYS = ("name", "description", "threads", "sources", "stages", "results")
STAGE_KEYS = ("stage", "inputs", "feedback", "settings", "host")
RESERVED = ("sources", "results")
NAME_PATTERN = r"[A-Za-z_][A-Za-z0-9_-]*"
# Hosts become names of topics and nodes in other runtimes.
HOST_PATTERN = r"[A-Za-z][A-Za-z0-9_]*"


def config_names() -> list[str]:
    """Return the names of the configurations that the package ships, sorted."""
    shipped = files("mdcs_pipeline.configs").iterdir()
    return sorted(f.name.removesuffix(".yaml") for f in shipped if f.name.endswith(".yaml"))


def load_spec(config: str | Path, overrides: Mapping[str, Any] | None = None) -> PipelineSpec:
    """Return the pipeline that a configuration describes.

    Parameters
    ----------
    config : str or Path
        A name out of `config_names()`, or the path of a YAML file.
    overrides : mapping, optional
        Settings put over those of the file: ``{"transport.epsilon": 0.002}`` or
        ``{"transport": {"epsilon": 0.002}}``; for a source
        ``{"sources.cloud.nonfinite": "refuse"}``.

    Returns
    -------
    PipelineSpec

    Raises
    ------
    ConfigError
        If there is no such configuration, or it is not one; with file and line.
    """
    data, file = _config_bytes(config)
    return override_spec(parse_spec(data, file), overrides or {})


def _config_bytes(config: str | Path) -> tuple[bytes, str]:
    names = config_names()
    if isinstance(config, str) and config in names:
        shipped = files("mdcs_pipeline.configs") / f"{config}.yaml"
        return shipped.read_bytes(), f"{config}.yaml"
    path = Path(config)
    looks_like_file = isinstance(config, Path) or path.suffix or os.sep in config
    if not looks_like_file and not path.is_file():
        raise ConfigError(
            f"unknown configuration '{config}'",
            received=f"shipped are: {', '.join(names) or 'none'}",
            remedy=f"{suggestion(str(config), names)} (or give the path of a YAML file)",
        )
    try:
        return path.read_bytes(), str(path)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ConfigError(
            f"the configuration cannot be read: {reason}",
            where=str(path),
            remedy=f"give the path of a YAML file, or one of: {', '.join(names)}",
        ) from error


def parse_spec(
    text: str | bytes, file: str = "<text>", environment: Mapping[str, str] | None = None
) -> PipelineSpec:
    """Return the pipeline that a YAML text describes.

    Parameters
    ----------
    text : str or bytes
        Bytes are UTF-8.
    file : str
        Named in errors.
    environment : mapping, optional
        What ``${NAME}`` stands for; the process's environment when absent.

    Raises
    ------
    ConfigError
        With file and line.
    """
    # A lone surrogate cannot be encoded; passed on, it is refused as not UTF-8.
    data = text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text
    root = read_document(data, file, os.environ if environment is None else environment)
    top = known_keys(root, PIPELINE_KEYS, "the pipeline")
    if "stages" not in top:
        raise ConfigError("the pipeline has no stages", where=file, remedy="add 'stages:'")
    description = top.get("description")
    return PipelineSpec(
        name=text_of(top["name"], "name") if "name" in top else Path(file).stem,
        description="" if description is None else text_of(description, "description"),
        sources={k: _source(k, b) for k, b in _named(top.get("sources"), "sources").items()},
        stages={k: _stage(k, b) for k, b in _named(top["stages"], "stages").items()},
        results={
            k: _ref(b, f"result '{k}'") for k, b in _named(top.get("results"), "results").items()
        },
        file=file,
        threads=_threads(top.get("threads")),
    )


def _threads(branch: Branch | None) -> int:
    return 1 if branch is None else checked_threads(branch.plain(), branch.place)


def _named(branch: Branch | None, what: str) -> dict[str, Branch]:
    if branch is None or branch.value is None:
        return {}
    entries = entries_of(branch, what)
    for name, value in entries.items():
        if not re.fullmatch(NAME_PATTERN, name):
            raise ConfigError(
                f"'{name}' cannot be a name in {what}",
                where=str(value.place),
                remedy="use letters, digits, _ and -, and begin with a letter",
            )
        if name in RESERVED and what == "stages":
            raise ConfigError(
                f"a stage cannot be called '{name}'",
                where=str(value.place),
                remedy=f"the name is kept for the {name} of the graph; choose another",
            )
    return entries


def _source(name: str, branch: Branch) -> SourceSpec:
    if branch.value is None:
        return SourceSpec(name, "drop", branch.place)
    entries = known_keys(branch, ("nonfinite",), f"source '{name}'")
    held = entries.get("nonfinite")
    nonfinite = "drop" if held is None else checked_nonfinite(name, held.plain(), held.place)
    return SourceSpec(name, nonfinite, branch.place)


def _stage(name: str, branch: Branch) -> StageSpec:
    if branch.value is None:
        return StageSpec(name, name, branch.place)
    what = f"stage '{name}'"
    entries = known_keys(branch, STAGE_KEYS, what)

    def part(key: str) -> dict[str, Branch]:
        held = entries.get(key)
        return {} if held is None or held.value is None else entries_of(held, f"{key} of {what}")

    settings = part("settings")
    return StageSpec(
        name=name,
        stage=text_of(entries["stage"], f"'stage' of {what}") if "stage" in entries else name,
        place=branch.place,
        inputs={
            port: tuple(_ref(item, f"input '{port}' of {what}") for item in _items(held))
            for port, held in part("inputs").items()
        },
        feedback={
            port: tuple(_feedback(item, f"feedback '{port}' of {what}") for item in _items(held))
            for port, held in part("feedback").items()
        },
        settings={key: held.plain() for key, held in settings.items()},
        setting_places={key: held.place for key, held in settings.items()},
        host=_host(entries["host"], what) if "host" in entries else MAIN_HOST,
    )


def _host(branch: Branch, what: str) -> str:
    name = text_of(branch, f"'host' of {what}")
    if re.fullmatch(HOST_PATTERN, name):
        return name
    raise ConfigError(
        f"'{name}' cannot be the host of {what}",
        where=str(branch.place),
        remedy="use letters, digits and _, and begin with a letter",
    )


def _items(branch: Branch) -> list[Branch]:
    return branch.value if isinstance(branch.value, list) else [branch]


def _ref(branch: Branch, what: str) -> Ref:
    text = branch.value
    if isinstance(text, str) and re.fullmatch(rf"{NAME_PATTERN}\.{NAME_PATTERN}", text):
        stage, port = text.split(".")
        return Ref(stage, port, branch.place)
    raise ConfigError(
        f"{what} must be written stage.port",
        where=str(branch.place),
        received=branch.plain(),
        remedy="name an output, such as merge.nodes, or a source, such as sources.cloud",
    )


def _feedback(branch: Branch, what: str) -> FeedbackSpec:
    entries = known_keys(branch, ("from", "max_rounds"), what)
    if "from" not in entries:
        raise ConfigError(
            f"{what} has no 'from'", where=str(branch.place), remedy="add 'from: stage.port'"
        )
    held = entries.get("max_rounds")
    rounds = None if held is None else held.value
    if rounds is not None and (not isinstance(rounds, int) or isinstance(rounds, bool)):
        place = branch.place if held is None else held.place
        raise ConfigError(
            f"max_rounds of {what} must be an integer", where=str(place), received=rounds
        )
    return FeedbackSpec(_ref(entries["from"], what), rounds, branch.place)
