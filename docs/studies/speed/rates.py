"""The command ``python -m docs.studies speed``, which measures the speed of dcgrid on this machine."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rich.table import Table

from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.terminal import plain_console, say, working
from dcgrid_env.core.files import write_json
from dcgrid_env.core.threads import n_threads
from dcgrid_env.core.versions import meta, versions
from dcgrid_env.scenario.presets import make_scenario
from docs.studies.speed.device_power_flows import device_power_flow_rows
from docs.studies.speed.environment_rates import environment_rows, memory_row, three_phase_environment_rows
from docs.studies.speed.measuring import Row
from docs.studies.speed.power_flow_rates import Case, power_flow_rows, reference_rows
from docs.studies.speed.tensors import tensor_rows
from docs.studies.speed.three_phase_rates import FEEDER as THREE_PHASES
from docs.studies.speed.three_phase_rates import ThreePhaseCase, three_phase_reference_rows, three_phase_rows

PACKAGES = ("torch", "pandapower", "power-grid-model", "lightsim2grid", "OpenDSSDirect.py", "dss_python_backend")


@dataclass(frozen=True)
class Speed(Command):
    """Measure environments, power flows and other libraries.

    Environments step with random actions drawn beforehand, resets included. Batches of torch tensors run on a device,
    with and without the derivative, in float32 and float64. The power flow alone is timed by arrays and by torch
    tensors on the device, with its worst voltage error. Further rows are the memory of a large batch, and other
    libraries on the same feeder and loads. Every rate is the median of several blocks after a warm-up.
    """

    seconds: float = 2.0
    """Time for each measurement, after its warm-up."""
    scenario: str = "ieee123"
    """Name of a scenario (dcgrid list)."""
    num_envs: int = 512
    """Environments in the native batch."""
    feeders: int = 4096
    """Feeders in a batch of power flows."""
    memory_num_envs: int = 10_000
    """Environments in the batch whose memory is measured."""
    device: str = "cpu"
    """Where the torch tensors are: cpu, cuda, or cuda:1 and so on."""
    reference_solvers: bool = True
    """Whether to measure the other power-flow libraries that are installed."""
    json: Path | None = None
    """File for the figures, if they are wanted as JSON too."""

    def run(self) -> None:
        """Measure, print, write. ValueError for an invalid setting."""
        console, rows = plain_console(), []
        with working(console, "measuring"):
            rows.extend(measure(self))
        described = about()
        console.print(table(rows, self.scenario))
        installed = [f"{package} {number}" for package, number in described["versions"].items() if number is not None]
        say(console, ", ".join(installed))
        say(console, ", ".join(f"{name} {value}" for name, value in described["machine"].items()))
        if self.json is not None:
            settings = {name: value for name, value in asdict(self).items() if name != "json"}
            write_json(self.json, {"meta": described, "settings": settings, "rows": [asdict(row) for row in rows]})


def measure(cfg: Speed) -> Iterator[Row]:
    """Every line of the table. ValueError for an invalid setting."""
    counts = {"num_envs": cfg.num_envs, "feeders": cfg.feeders, "memory_num_envs": cfg.memory_num_envs}
    if not cfg.seconds > 0.0 or min(counts.values()) < 1:
        raise ValueError(f"seconds is {cfg.seconds} and {counts}; give more than 0 s and at least 1 of each")
    scenario = make_scenario(cfg.scenario)
    tensors = tensor_rows(scenario, cfg.device, cfg.seconds)
    yield from environment_rows(scenario, cfg.num_envs, cfg.seconds)
    yield from three_phase_environment_rows(make_scenario(THREE_PHASES), cfg.num_envs, cfg.seconds)
    yield from tensors
    case = Case.draw(scenario, cfg.feeders)
    yield from power_flow_rows(case, cfg.seconds)
    three_phase = ThreePhaseCase.draw(cfg.feeders)
    yield from three_phase_rows(three_phase, cfg.seconds)
    if find_spec("torch") is not None:
        yield from device_power_flow_rows(case, three_phase, cfg.device, cfg.seconds)
    yield memory_row(cfg.scenario, cfg.memory_num_envs)
    if cfg.reference_solvers:
        yield from reference_rows(case, cfg.seconds)
        yield from three_phase_reference_rows(three_phase, cfg.seconds)


def about() -> dict[str, Any]:
    """Versions and machine: those of every result, the other libraries' and the processor's name besides."""
    described = meta()
    described["versions"] |= versions(PACKAGES)
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines() if cpuinfo.exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    described["machine"] |= {"processor": models[0] if models else platform.processor(), "threads": n_threads()}
    return described


def table(rows: list[Row], scenario: str) -> Table:
    """The rows as a table for the terminal."""
    shown = Table(title=f"dcgrid, {scenario}", title_justify="left", header_style="bold")
    shown.add_column("what")
    shown.add_column("figure", justify="right")
    shown.add_column("unit")
    shown.add_column("worst voltage error, p.u.", justify="right")
    for row in rows:
        figure = "" if row.value is None else f"{row.value:,.0f}" if row.value >= 100 else f"{row.value:.3g}"
        error = "" if row.error_pu is None else f"{row.error_pu:.1e}"
        shown.add_row(row.name, figure, row.unit, error)
    return shown
