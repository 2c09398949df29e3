"""The command ``dcgrid study``."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from dcgrid_env.cli.own_feeder import FeederRequest, scenario_on_feeder
from dcgrid_env.core.commands.progress import progress_bar
from dcgrid_env.core.commands.settings import check_folder
from dcgrid_env.core.commands.terminal import plain_console, say
from dcgrid_env.core.commands.workers import OverWorkers
from dcgrid_env.core.files import write_json, write_text
from dcgrid_env.core.user_files import read_toml

if TYPE_CHECKING:
    from dcgrid_env import Scenario
    from dcgrid_env.apps.hosting.connection_study.study_job import Job
    from dcgrid_env.apps.hosting.connection_study.study_request import StudyRequest


_FILES = ("load_profiles.file", "load_profiles.classes", "workload.trace", "trace")
"""Fields of ``set`` that name files."""


@dataclass(frozen=True)
class ConnectionStudy(OverWorkers):
    """Answer a connection request with one report.

    Reads the request from a TOML file. Writes one HTML page without external resources, which a browser also prints.

    The report contains base case, capacity, worst window, a day, ride-through, fluctuation and sensitivity. On request
    it contains outages, several sites at once and a year of load profiles. It lists what was not checked, and all
    inputs with their hashes (docs/connection-study.md).
    """

    file: tyro.conf.Positional[Path]
    """Study file (.toml) with bus, mw, feeder or scenario, and settings."""
    allow: str = ""
    """unverified: go on with an imported feeder whose voltages are not those of the program that it comes from."""
    out: Path = Path("results/study")
    """Folder for report.html, report.json and capacity.csv. Created if missing."""

    def run(self) -> None:
        """Compute all sections, then write; raise ValueError before anything is written if a setting is invalid."""
        from dcgrid_env.apps.hosting.capacity_output import capacity_csv
        from dcgrid_env.apps.hosting.connection_study.connection_report import (
            answers,
            asked_sections,
            page,
            report_json,
            sections_of,
        )
        from dcgrid_env.apps.hosting.hosting import hosting_capacity
        from dcgrid_env.baselines.engineering import file_lines

        place = self.place
        request = read_request(self.file)
        job = make_job(request, self.file)
        check_folder(self.out)
        console = plain_console()
        capacities = None
        with progress_bar(console) as progress:
            if "capacity" not in request.leave_out:
                total = len(job.study.candidates()) * len(request.controllers)
                task = progress.add_task("capacity", total=total)
                capacities = hosting_capacity(
                    job.study, request.controllers, place, None, lambda _, n: progress.advance(task, n)
                )
            task = progress.add_task("sections", total=len(asked_sections(job)) + len(job.outages))
            sections = sections_of(job, capacities, self.file, place, lambda: progress.advance(task))
        written = page(job, capacities, sections)
        lines = file_lines(job.scenario(request.mw, **job.study.window_fields))
        for text in (job.source, *answers(job, capacities), *lines):
            say(console, text)
        if capacities is not None:
            write_text(self.out / "capacity.csv", capacity_csv(capacities))
        write_json(self.out / "report.json", report_json(job, capacities, sections))
        write_text(self.out / "report.html", written)
        say(console, f"wrote {self.out / 'report.html'} and {self.out / 'report.json'}")


def read_request(path: Path) -> StudyRequest:
    """Read a study's file; raise ValueError naming the file, the field and the value for an invalid one."""
    from dcgrid_env.apps.hosting.connection_study.study_request import StudyRequest
    from dcgrid_env.core.checked import FieldError, from_mapping

    try:
        fields = read_toml(path, ValueError)
    except (FileNotFoundError, IsADirectoryError):
        raise ValueError(f"file: there is no study file {path}; write one (docs/connection-study.md)") from None
    try:
        return from_mapping(StudyRequest, fields)
    except FieldError as error:
        raise ValueError(f"{path}: {error.said(error.name)}") from None


def make_job(request: StudyRequest, path: Path) -> Job:
    """Make the study of a request; raise ValueError for an unknown bus, feeder, scenario or field."""
    from dcgrid_env.apps.hosting.capacity_study import Study
    from dcgrid_env.apps.hosting.connection_study.study_job import Job
    from dcgrid_env.apps.hosting.outages import outages_asked

    scenario = _scenario(request, path)
    if request.bus not in scenario.feeder.bus_ids[1:]:
        raise ValueError(
            f"{path}: bus is {request.bus!r}; give a bus of feeder {scenario.feeder.name!r} other than the substation"
        )
    settings = dict(request.capacity)
    buses = settings.pop("buses", None)
    if buses == "all":
        buses = scenario.feeder.bus_ids[1:]
    if buses is not None:
        buses = tuple(dict.fromkeys((*map(str, buses), request.bus)))
    unknown = set(settings) - {field.name for field in fields(Study)} | set(settings) & {"scenario", "others"}
    if unknown:
        raise ValueError(f"{path}: capacity has no field {min(unknown)!r}; see docs/connection-study.md")
    study = Study(scenario=scenario, others=request.scenario is not None, buses=buses, **settings)
    if buses is None and scenario.feeder.index(request.bus) not in study.candidates():
        names = tuple(scenario.feeder.bus_ids[i] for i in study.candidates())
        study = Study(scenario=scenario, others=study.others, buses=(*names, request.bus), **settings)
    if study.outage_rating is not None and not request.outages:
        raise ValueError(
            f"{path}: outage_rating is {study.outage_rating!r} without outages; name outages or leave it out"
        )
    if request.outages and "capacity" in request.leave_out:
        raise ValueError(f"{path}: outages need the section capacity; remove it from leave_out")
    if request.several_sites is not None:
        buses = (request.bus, *request.several_sites.buses)
        Study(scenario=scenario, buses=buses).candidates()  # which names an unknown bus
    job = Job(request, study, outages_asked(scenario, request.outages))
    job.scenario(request.mw)  # which names a bus that is taken, or drawn sites
    return job


def _scenario(request: StudyRequest, path: Path) -> Scenario:
    from dcgrid_env.baselines.engineering import engineering_scenario
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec
    from dcgrid_env.grid import FEEDER_REGISTRY
    from dcgrid_env.scenario.toml import folder_text

    values = [(name, _from_folder(path.parent, name, value)) for name, value in _flat(request.set)]
    overrides = tuple(f"{name}={json.dumps(value)}" for name, value in values)
    if request.feeder is None:
        return engineering_scenario(ScenarioSpec(str(request.scenario), overrides).make)
    folder, is_name = path.parent / request.feeder, request.feeder in FEEDER_REGISTRY
    feeder = folder_text(folder) if folder.is_dir() and not is_name else request.feeder
    feeder_request = FeederRequest(feeder, request.scenario, None, None)
    return engineering_scenario(lambda split: scenario_on_feeder(feeder_request, overrides, split, {}))


def _from_folder(folder: Path, name: str, value: object) -> object:
    """Return the path of a file that is relative to the study's folder; any other value unchanged."""
    if isinstance(value, list) and name in _FILES:
        return [_from_folder(folder, name, item) for item in value]
    if name not in _FILES or not isinstance(value, str):
        return value
    return str(folder / value) if (folder / value).exists() else value


def _flat(table: dict[str, Any], before: str = "") -> list[tuple[str, Any]]:
    """The fields of nested tables by their path."""
    fields: list[tuple[str, Any]] = []
    for name, value in table.items():
        if isinstance(value, dict):
            fields += _flat(value, f"{before}{name}.")
        else:
            fields.append((before + name, value))
    return fields
