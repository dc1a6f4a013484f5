"""Values of any kind as plain JSON ones."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np


def plain(value: object) -> Any:
    """Return `value` as what strict JSON can hold.

    Arrays become lists, and NaN and infinity null, for JSON has no name for them. What has
    no form in JSON becomes its text: a stage's odd diagnostic must not cost the result.
    """
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if hasattr(value, "model_dump"):
        value = value.model_dump(mode="json")
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {item.name: getattr(value, item.name) for item in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, set | frozenset):
        return sorted((plain(item) for item in value), key=repr)
    return str(value)


def json_text(value: object) -> str:
    """Return strict JSON on one line; floats keep every bit."""
    return json.dumps(plain(value), allow_nan=False, ensure_ascii=False)
