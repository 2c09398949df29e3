"""Settings that were found for an algorithm on a preset; they ship with the package, in preset_settings.toml."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path
from typing import Any

PATH = Path(__file__).with_suffix(".toml")


def settings(algorithm: str, scenario: str) -> dict[str, Any]:
    """What differs from an algorithm's defaults on a scenario: fields of its configuration by name.

    Empty where nothing was found: for several scenarios, or a scenario that is not a preset.
    """
    found = _all().get(algorithm, {}).get(scenario, {})
    return {name: tuple(value) if isinstance(value, list) else value for name, value in found.items()}


@cache
def _all() -> dict[str, dict[str, dict[str, Any]]]:
    """By algorithm and preset."""
    return tomllib.loads(PATH.read_text(encoding="utf-8"))
