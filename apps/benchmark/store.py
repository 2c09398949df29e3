"""Finished units on disk, one file each, so that an interrupted benchmark goes on where it was.

    OUT/units/about.json                                    format and version of the package
    OUT/units/SCENARIO/CONTROLLER/FIRST-LAST.json           what ``jobs.run`` gave for FIRST to LAST, and its hash

A unit counts as done if everything that defines it is the same. If the package version or the scenario differs, the
whole folder is refused, since two benchmarks would mix. If only the controller has changed (its parameters, or the file
of its class), the unit is recomputed. Other changes of code under one version are not detected: use another OUT then.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dcgrid_env import __version__
from dcgrid_env.apps.benchmark.jobs import Unit
from dcgrid_env.baselines.file_names import file_name
from dcgrid_env.core.files import write_json
from dcgrid_env.core.user_files import read_json

FORMAT = {"what": "units of dcgrid benchmark", "format": 2}


class Store:
    """The units in ``out / "units"``.

    Raises
    ------
    ValueError
        Where ``out`` holds the results of another command, or of another version of the package.
    """

    def __init__(self, out: Path):
        self.out = out
        self.folder = out / "units"
        self._about = FORMAT | {"version": __version__}
        about_file = self.folder / "about.json"
        if about_file.is_file():
            about = _read(about_file)
            for key, value in self._about.items():
                if about.get(key) != value:
                    raise ValueError(
                        f"{self.folder} holds units of {key} {about.get(key)!r}, this is {value!r}; give another "
                        f"--out, or delete that folder and {out / 'results.json'}"
                    )
        elif (out / "results.json").exists():
            raise ValueError(f"{out} holds the results of another command (results.json); give another --out")

    def get(self, unit: Unit) -> dict[str, Any] | None:
        """The unit's record if it is done; None if not, or if its controller has changed since.

        ValueError where it is of another form of the scenario, or damaged in any way.
        """
        path = self.path(unit)
        if not path.is_file():
            return None
        record = _read(path)
        if record.pop("sha256", None) != _digest(record):
            raise ValueError(f"{path} is damaged (its sha256 is another); delete it, and it is computed anew")
        stored = record["unit"]
        if stored.get("scenario_hash") != unit.scenario_hash:
            raise ValueError(
                f"{path} is of another {unit.scenario}, of hash {stored.get('scenario_hash')} and not "
                f"{unit.scenario_hash}; give another --out, or delete {path.parents[1]}"
            )
        return record if stored == asdict(unit) else None

    def put(self, unit: Unit, record: dict[str, Any]) -> None:
        """Keep a finished unit."""
        if not (self.folder / "about.json").is_file():
            write_json(self.folder / "about.json", self._about)
        write_json(self.path(unit), record | {"sha256": _digest(record)})

    def path(self, unit: Unit) -> Path:
        """The unit's file."""
        last = unit.first + unit.episodes - 1
        return self.folder / file_name(unit.scenario) / file_name(unit.controller) / f"{unit.first}-{last}.json"


def _digest(record: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


def _read(path: Path) -> dict[str, Any]:
    content = read_json(path, ValueError, "delete it, and it is computed anew")
    if not isinstance(content, dict):
        raise ValueError(f"{path} is no unit; delete it, and it is computed anew")
    return content
