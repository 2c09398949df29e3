"""Lists of names as the command line takes them."""

from __future__ import annotations


def split_names(text: str) -> list[str]:
    """Names separated by commas, each once, in order."""
    return list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))


def scenario_names(text: str) -> list[str]:
    """Names of presets, or all of them for ``all``; ValueError for one that does not exist, or none."""
    from dcgrid_env import PRESETS

    names = list(PRESETS) if text.strip() == "all" else split_names(text)
    unknown = [name for name in names if name not in PRESETS]
    if unknown:
        raise ValueError(f"unknown scenario {unknown[0]!r}; there are {', '.join(PRESETS)}")
    if not names:
        raise ValueError(f"scenarios is {text!r}; name at least one, or all (dcgrid list)")
    return names
