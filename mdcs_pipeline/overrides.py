"""Settings put over those of a file, from Python or from a command line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from mdcs_pipeline.document import Place, scalar_of
from mdcs_pipeline.errors import ConfigError, suggestion
from mdcs_pipeline.spec import PipelineSpec, checked_nonfinite, checked_threads

# The one setting that is no stage's.
THREADS = "threads"


def parse_override(text: str) -> tuple[str, Any]:
    """Return key and value of ``stage.setting=value``, as a command line gives it.

    The value is read as a plain YAML scalar: 0.002 and 1e-3 are numbers, true a truth value.

    Raises
    ------
    ConfigError
        If it is not of that form.
    """
    key, equals, value = text.partition("=")
    stage, dot, setting = key.strip().partition(".")
    if not (equals and (key.strip() == THREADS or (dot and stage and setting))):
        raise ConfigError(
            "an override must be written stage.setting=value",
            received=text,
            remedy="for example transport.epsilon=0.002",
        )
    try:
        return key.strip(), scalar_of(value.strip())
    except ValueError as error:
        raise ConfigError(
            f"the value of '{key.strip()}' cannot be read", received=value, remedy=str(error)
        ) from error


def override_spec(spec: PipelineSpec, overrides: Mapping[str, Any]) -> PipelineSpec:
    """Return the pipeline with settings put over those of its file; see `load_spec`."""
    for key, value in _flat(overrides, spec).items():
        head, _, rest = key.partition(".")
        place = Place(f"override '{key}'")
        if key == THREADS:
            spec = replace(spec, threads=checked_threads(value, place))
            continue
        if head == "sources":
            spec = _override_source(spec, rest, value, place)
            continue
        if head not in spec.stages:
            raise ConfigError(
                f"{spec.name} has no stage '{head}'",
                where=str(place),
                remedy=suggestion(head, [*spec.stages, "sources"]),
            )
        stage = spec.stages[head]
        changed = replace(
            stage,
            settings={**stage.settings, rest: value},
            setting_places={**stage.setting_places, rest: place},
        )
        spec = replace(spec, stages={**spec.stages, head: changed})
    return spec


def _override_source(spec: PipelineSpec, rest: str, value: object, place: Place) -> PipelineSpec:
    name, _, key = rest.partition(".")
    if name not in spec.sources or key != "nonfinite":
        known = [f"sources.{source}.nonfinite" for source in spec.sources]
        raise ConfigError(
            "sources have no such setting",
            where=str(place),
            remedy=suggestion(f"sources.{rest}", known),
        )
    changed = replace(spec.sources[name], nonfinite=checked_nonfinite(name, value, place))
    return replace(spec, sources={**spec.sources, name: changed})


def _flat(overrides: Mapping[str, Any], spec: PipelineSpec) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in overrides.items():
        head, dot, rest = key.partition(".")
        of_source = head == "sources" and rest.count(".") == 0
        if isinstance(value, Mapping) and (not dot or of_source):
            flat.update(_flat({f"{key}.{name}": held for name, held in value.items()}, spec))
        elif (dot and rest) or key == THREADS:
            flat[key] = value
        else:
            raise ConfigError(
                f"'{key}' alone is no setting",
                received=value,
                remedy=f"write {head or 'stage'}={{'setting': value}} or 'stage.setting': value; "
                f"{suggestion(head, spec.stages)}",
            )
    return flat
