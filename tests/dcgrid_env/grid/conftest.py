"""A small feeder given by hand, as tables and as files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from dcgrid_env import Feeder

FILES = {
    "feeder.toml": 'name = "hand"\nbase_kv = 10.0\nsubstation = 7\nv0_pu = 1.02\n',
    "buses.csv": "bus,p_kw,q_kvar,capacitor_kvar,x,y\n3,30,3,0,0.5,1.5\n7,0,0,0,0,0\n5,50,5,55,,\n",
    "branches.csv": "from_bus,to_bus,r_ohm,x_ohm\n3,5,0.25,0.5\n7,3,1,2\n",
}


@pytest.fixture
def tables() -> dict[str, Any]:
    """Arguments of ``from_tables``: sub - a, a - b (a switch), a - c, c - d; branches out of order, some turned."""
    return {
        "name": "hand",
        "base_kv": 10.0,
        "substation": "sub",
        "v0_pu": 1.01,
        "bus_ids": ["d", "a", "sub", "c", "b"],
        "p_load_kw": [40.0, 10.0, 1.0, 30.0, 20.0],
        "q_load_kvar": [4.0, 1.0, 0.1, 3.0, 2.0],
        "capacitor_kvar": [400.0, 100.0, 0.0, 300.0, 200.0],
        "from_bus": ["d", "a", "a", "c"],
        "to_bus": ["c", "b", "sub", "a"],
        "r_ohm": [4.0, 0.0, 1.0, 3.0],
        "x_ohm": [8.0, 0.0, 2.0, 6.0],
        "x": [4.5, 1.5, 0.0, 3.5, 2.5],
        "y": [-4.0, -1.0, 0.0, -3.0, -2.0],
    }


@pytest.fixture
def build(tables: dict[str, Any]) -> Callable[..., Feeder]:
    """Build the hand-given feeder with some arguments replaced."""
    return lambda **changes: Feeder.from_tables(**{**tables, **changes})


@pytest.fixture
def folder(tmp_path: Path) -> Callable[..., Path]:
    """Write the three files of a good feeder 7 - 3 - 5, some replaced; None leaves a file out."""

    def write(**changes: str | None) -> Path:
        for name, text in FILES.items():
            text = changes.get(name.split(".")[0], text)
            if text is not None:
                (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path

    return write
