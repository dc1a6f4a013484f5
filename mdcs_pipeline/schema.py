"""The JSON Schema of the YAML format, from which editors complete and check it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mdcs_pipeline.checks import type_name
from mdcs_pipeline.config import HOST_PATTERN, NAME_PATTERN, PIPELINE_KEYS, RESERVED
from mdcs_pipeline.spec import MAIN_HOST, NONFINITE
from mdcs_pipeline.stage import Stage, input_ports, installed

DIALECT = "https://json-schema.org/draft/2020-12/schema"
_REFERENCE = {"type": "string", "pattern": rf"^{NAME_PATTERN}\.{NAME_PATTERN}$"}
_FROM_ENVIRONMENT = {"type": "string", "pattern": r"\$\{"}
_NAMES = {"pattern": f"^{NAME_PATTERN}$", "not": {"enum": list(RESERVED)}}


def json_schema(stages: Mapping[str, type[Stage[Any]]] | None = None) -> dict[str, Any]:
    """Return the JSON Schema of a pipeline's YAML.

    Parameters
    ----------
    stages : mapping, optional
        Stage classes by registered name; all installed ones when absent.

    Returns
    -------
    dict
        Draft 2020-12. Settings may be ``${NAME}`` in place of a value, and none is
        required, since a command line may give it.

    Raises
    ------
    ConfigError
        If an installed stage cannot be loaded.
    """
    known = installed() if stages is None else dict(stages)
    definitions: dict[str, Any] = {"stage": _stage(list(known)), "feedback": _feedback()}
    for name, stage in known.items():
        definitions[f"{name}.settings"] = _settings(name, stage)
        definitions[f"{name}.inputs"] = _inputs(stage)
    return {
        "$schema": DIALECT,
        "title": "mdcs pipeline",
        "type": "object",
        "properties": _properties(known),
        "required": ["stages"],
        "additionalProperties": False,
        "$defs": definitions,
    }


def _properties(known: Mapping[str, type[Stage[Any]]]) -> dict[str, Any]:
    named = {
        "name": {"type": "string", "description": "Name of the pipeline."},
        "description": {"type": "string", "description": "What it does, in one line."},
        "threads": {
            "type": "integer",
            "minimum": 1,
            "default": 1,
            "description": "Most threads a stage may use; the processors, OMP_NUM_THREADS and "
            "NUMBA_NUM_THREADS bound them. No result depends on it.",
        },
        "sources": {
            "type": "object",
            "description": "Clouds that enter; a stage takes one as sources.NAME.",
            "propertyNames": _NAMES,
            "additionalProperties": _source(),
        },
        "stages": {
            "type": "object",
            "description": "The stages; the key is the stage's name in the graph.",
            "minProperties": 1,
            "propertyNames": _NAMES,
            "properties": {name: _by_key(name) for name in known},
            "additionalProperties": {
                "allOf": [{"$ref": "#/$defs/stage"}, {"type": "object", "required": ["stage"]}]
            },
        },
        "results": {
            "type": "object",
            "description": "What leaves: the name of the result and the output it is.",
            "propertyNames": _NAMES,
            "additionalProperties": _REFERENCE,
        },
    }
    return {key: named[key] for key in PIPELINE_KEYS}


def _source() -> dict[str, Any]:
    nonfinite = {
        "enum": list(NONFINITE),
        "default": "drop",
        "description": "Points with NaN or infinity: drop and count them, or refuse the cloud.",
    }
    return {
        "type": ["object", "null"],
        "properties": {"nonfinite": nonfinite},
        "additionalProperties": False,
    }


def _feedback() -> dict[str, Any]:
    return {
        "type": "object",
        "properties": {
            "from": _REFERENCE,
            "max_rounds": {
                "type": "integer",
                "minimum": 1,
                "description": "How many values the edge carries in one frame.",
            },
        },
        "required": ["from", "max_rounds"],
        "additionalProperties": False,
    }


def _stage(names: list[str]) -> dict[str, Any]:
    back = {"$ref": "#/$defs/feedback"}
    return {
        "type": ["object", "null"],
        "properties": {
            "stage": {"enum": names, "description": "Registered name; the key by default."},
            "inputs": {"type": ["object", "null"]},
            "feedback": {
                "type": ["object", "null"],
                "additionalProperties": {"anyOf": [back, {"type": "array", "items": back}]},
            },
            "settings": {"type": ["object", "null"]},
            "host": {
                "type": "string",
                "pattern": f"^{HOST_PATTERN}$",
                "default": MAIN_HOST,
                "description": "Process that runs the stage where the graph is cut.",
            },
        },
        "additionalProperties": False,
        "allOf": [
            {
                "if": {"properties": {"stage": {"const": name}}, "required": ["stage"]},
                "then": _parts(name),
            }
            for name in names
        ],
    }


def _parts(name: str) -> dict[str, Any]:
    return {
        "properties": {
            "inputs": {"$ref": f"#/$defs/{name}.inputs"},
            "settings": {"$ref": f"#/$defs/{name}.settings"},
        }
    }


def _by_key(name: str) -> dict[str, Any]:
    own = {"if": {"not": {"type": "object", "required": ["stage"]}}, "then": _parts(name)}
    return {"allOf": [{"$ref": "#/$defs/stage"}, own]}


def _inputs(stage: type[Stage[Any]]) -> dict[str, Any]:
    ports = {}
    for name, port in input_ports(stage).items():
        listed: dict[str, Any] = {"type": "array", "items": _REFERENCE, "minItems": 1}
        if not port.many:
            listed["maxItems"] = 1
        ports[name] = {"description": type_name(port), "anyOf": [_REFERENCE, listed]}
    return {"type": ["object", "null"], "properties": ports, "additionalProperties": False}


def _settings(name: str, stage: type[Stage[Any]]) -> dict[str, Any]:
    template = f"#/$defs/{name}.settings/$defs/{{model}}"
    held = stage.Settings.model_json_schema(ref_template=template)
    held.pop("required", None)
    held["type"] = ["object", "null"]
    held["properties"] = {
        key: _or_environment(value) for key, value in held.get("properties", {}).items()
    }
    return held


def _or_environment(value: dict[str, Any]) -> dict[str, Any]:
    notes = {str(k): value[k] for k in ("title", "description", "default") if k in value}
    rest = {k: v for k, v in value.items() if k not in notes}
    return {**notes, "anyOf": [rest, _FROM_ENVIRONMENT]}
