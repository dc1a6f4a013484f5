"""Tells, where dora is not installed, that its tests were left out."""

from __future__ import annotations

import pytest


def test_dora_is_tested_in_an_environment_of_its_own() -> None:
    pytest.importorskip("dora", reason="dora has its own environment: make test-dora")
