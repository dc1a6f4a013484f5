"""The schema beside the shipped configurations, which editors read."""

from __future__ import annotations

import json
from pathlib import Path

from mdcs_pipeline.schema import json_schema

SHIPPED = Path(__file__).parent.parent / "configs" / "mdcs-pipeline.schema.json"


def test_the_shipped_schema_is_the_one_that_the_settings_give() -> None:
    """Made again by: mdcs schema -o configs/mdcs-pipeline.schema.json."""
    assert json.loads(SHIPPED.read_text(encoding="utf-8")) == json_schema()
