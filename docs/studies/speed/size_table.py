"""The command ``python -m docs.studies speed-sizes``: how time and memory grow with the size of a feeder."""

from __future__ import annotations

import gc
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.files import write_json
from dcgrid_env.grid import Feeder
from dcgrid_env.powerflow import solver_for
from dcgrid_env.scenario.on_feeder import power_flow_of, scenario_on
from docs.studies.speed.environment_rates import resident_mib
from docs.studies.speed.measuring import ROOT, rate
from docs.studies.speed.synthetic_feeders import balanced_feeder, three_phase_feeder

N_ENV = 64
MEMORY_ENVS = 16


COLUMNS = {
    "n": ("nodes", "{:,.0f}"),
    "compile_s": ("compile, s", "{:.2f}"),
    "write_s": ("CSV out, s", "{:.2f}"),
    "read_s": ("CSV in, s", "{:.2f}"),
    "one_per_s": ("flows/s, single", "{:,.0f}"),
    "batch_per_s": (f"flows/s, batch of {N_ENV}", "{:,.0f}"),
    "ns_per_node": ("ns per flow and node", "{:.0f}"),
    "make_s": ("make and reset, s", "{:.2f}"),
    "steps_per_s": ("steps/s", "{:,.0f}"),
    "mib_per_env": ("MiB per environment", "{:.2f}"),
    "bytes_per_node": ("bytes per environment and node", "{:,.0f}"),
}
"""Column title and format of each figure of a feeder."""


@dataclass(frozen=True)
class SpeedSizes(Command):
    """Measure feeders of 100 to 100,000 buses.

    The feeders are synthetic; three-phase ones have up to 8,500 nodes. Each is measured in a separate process. The
    table contains the seconds to compile the tables into a feeder, to write it as CSV files and to read them. Power
    flows per second are from a cold start, one at a time and 64 in a batch. An environment of a few agents is measured
    by its seconds to make and reset, its steps per second, and the memory that each environment of a batch of 16
    adds. The table is printed in Markdown.
    """

    buses: tuple[int, ...] = (100, 1_000, 10_000, 50_000, 100_000)
    """Buses of the balanced feeders."""
    three_phase_nodes: tuple[int, ...] = (100, 1_000, 8_500)
    """Nodes of the three-phase feeders, some of them; none for no such feeder."""
    seconds: float = 1.0
    """Time for each rate, after its warm-up."""
    json: Path | None = None
    """File for the figures, if they are wanted as JSON too."""

    def run(self) -> None:
        """Measure, print, write. ValueError for an invalid setting."""
        if min((*self.buses, *self.three_phase_nodes), default=0) < 20 or not self.seconds > 0.0:
            sizes = f"buses is {self.buses}, three_phase_nodes {self.three_phase_nodes} and seconds {self.seconds}"
            raise ValueError(f"{sizes}; give sizes of at least 20 and more than 0 s")
        print("| feeder | " + " | ".join(heading for heading, _ in COLUMNS.values()) + " |")
        print("|---" + "|---:" * len(COLUMNS) + "|")
        records = []
        for record in measured(self):
            records.append(record)
            cells = [style.format(record[name]) for name, (_, style) in COLUMNS.items()]
            print(f"| {' | '.join([record['feeder'], *cells])} |", flush=True)
        if self.json is not None:
            write_json(self.json, {"rows": records})


def measured(cfg: SpeedSizes) -> Iterator[dict[str, Any]]:
    """Yield one record for each feeder, measured in a separate process; raise RuntimeError if that fails."""
    code = "import sys; from docs.studies.speed.size_table import report; report(*sys.argv[1:])"
    kinds = [("balanced", n) for n in cfg.buses] + [("three-phase", n) for n in cfg.three_phase_nodes]
    for kind, n in kinds:
        record: dict[str, Any] = {}
        for what in ("times", "memory"):
            command = [sys.executable, "-c", code, what, kind, str(n), str(cfg.seconds)]
            done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
            if done.returncode:
                raise RuntimeError(f"the process that measures {kind} {n} failed: {done.stderr.strip()}")
            record |= json.loads(done.stdout.splitlines()[-1])
        yield record


def report(what: str, kind: str, n: str, seconds: str) -> None:
    """Print the record of one feeder as a line of JSON: its times or its memory."""
    print(json.dumps(size_record(kind, int(n), float(seconds)) if what == "times" else memory_record(kind, int(n))))


def size_record(kind: str, n: int, seconds: float) -> dict[str, Any]:
    """Figures of one feeder, by the names of ``COLUMNS``."""
    build = balanced_feeder if kind == "balanced" else three_phase_feeder
    small = build(20)
    _environment(small, 1)  # imports and compiled code, which are no part of a feeder
    drawn = build(n)
    record: dict[str, Any] = {"feeder": f"{kind} {n:,}", "n": drawn.n_node}
    network = drawn.to_network()
    record["compile_s"], feeder = _timed(lambda: _compiled(type(drawn), network))
    with tempfile.TemporaryDirectory() as folder:
        record["write_s"], _ = _timed(lambda: feeder.to_csv(folder))
        record["read_s"], _ = _timed(lambda: type(drawn).from_csv(folder))
    record |= _flow_rates(feeder, seconds)
    record["make_s"], env = _timed(lambda: _environment(feeder, 1))
    action = np.zeros(env.action_space.shape or (), np.float32)
    record["steps_per_s"] = rate(partial(env.step, action), 1, seconds)
    return record


def memory_record(kind: str, n: int) -> dict[str, Any]:
    """What each environment adds to the memory of this process; measure it in a fresh one."""
    build = balanced_feeder if kind == "balanced" else three_phase_feeder
    feeder = build(n)
    kept = [_environment(feeder, 1)]  # what all environments share counts for none
    gc.collect()
    before = resident_mib()
    kept.append(_environment(feeder, MEMORY_ENVS))
    gc.collect()
    mib_per_env = (resident_mib() - before) / MEMORY_ENVS
    return {"mib_per_env": mib_per_env, "bytes_per_node": mib_per_env * 2**20 / feeder.n_node}


def _compiled(kind: Any, network: Any) -> Any:
    feeder = kind.from_network(network)
    solver_for(feeder, power_flow_of(feeder))(feeder, feeder.p_load_kw, feeder.q_load_kvar, feeder.v0_pu)
    return feeder


def _flow_rates(feeder: Any, seconds: float) -> dict[str, float]:
    solve = solver_for(feeder, power_flow_of(feeder))
    share = np.random.default_rng(0).uniform(0.7, 1.0, (N_ENV, 1))
    loads = feeder.p_load_kw * share, feeder.q_load_kvar * share
    if not solve(feeder, *loads, feeder.v0_pu).converged.all():
        raise ValueError(f"feeder {feeder.name!r} cannot carry its load")
    one_per_s = rate(lambda: solve(feeder, loads[0][0], loads[1][0], feeder.v0_pu), 1, seconds)
    batch_per_s = rate(lambda: solve(feeder, *loads, feeder.v0_pu), N_ENV, seconds)
    return {"one_per_s": one_per_s, "batch_per_s": batch_per_s, "ns_per_node": 1e9 / batch_per_s / feeder.n_node}


def _environment(feeder: Any, n_env: int) -> Any:
    """Some agents on the feeder in a batch that has taken two steps; sites stand fixed, at the first load buses."""
    from dcgrid_env import DcgridVectorEnv

    chosen = scenario_on(feeder)
    of_three = [i for i in chosen.candidates if isinstance(feeder, Feeder) or len(feeder.bus_phases[i]) == 3]
    sites = tuple(feeder.bus_ids[i] for i in of_three[: chosen.datacenters.count])
    scenario = chosen.replace(datacenters={"buses": sites}, horizon=1000)
    env = DcgridVectorEnv(n_env, scenario)
    env.reset(seed=0)
    for _ in range(2):
        env.step(np.zeros(env.action_space.shape or (), np.float32))
    return env


def _timed(work: Any) -> tuple[float, Any]:
    start = perf_counter()
    made = work()
    return perf_counter() - start, made
