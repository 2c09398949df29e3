"""How fast dcgrid is on this machine: ``python -m dcgrid_env.speed``.

Steps of the environments with random actions drawn beforehand, resets included; batches of torch tensors on a device,
with and without the derivative; the power flow alone, with its worst voltage error; the memory of a large batch; other
libraries on the same feeder and loads. Every rate is the median of several blocks after a warm-up. ``--help`` lists the
options.
"""

from __future__ import annotations

import gc
import itertools
import platform
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.core.files import write_json
from dcgrid_env.core.install import from_clone
from dcgrid_env.core.threads import n_threads
from dcgrid_env.core.versions import meta, versions
from dcgrid_env.grid import Feeder
from dcgrid_env.powerflow import Solution, distflow, lindistflow
from dcgrid_env.scenario.presets import make_scenario
from dcgrid_env.scenario.scenario import Scenario
from dcgrid_env.speed.measuring import Row, rate
from dcgrid_env.speed.reference_solvers import YARDSTICKS, Yardstick, missing
from dcgrid_env.speed.tensors import tensor_rows

FloatArray = NDArray[np.float64]

EXACT_KVA = 1e-9  # tolerance of the solves that errors are taken against; the default is 1e-4
CHANGE = 0.002  # of every load between two solves of which the second starts warm
SINGLES = 16  # different loads that single solves take turns with
PACKAGES = ("torch", "pandapower", "power-grid-model", "lightsim2grid", "OpenDSSDirect.py", "dss_python_backend")
MISSING = f"not installed ({from_clone('bench')})"


@dataclass(frozen=True)
class Speed:
    """What to measure, and for how long."""

    seconds: float = 2.0
    """Time for each measurement, after its warm-up."""
    scenario: str = "ieee123"
    """Name of a scenario (dcgrid list)."""
    batch: int = 512
    """Environments in the native batch."""
    feeders: int = 4096
    """Feeders in a batch of power flows."""
    lanes: int = 10_000
    """Environments in the batch whose memory is measured."""
    device: str = "cpu"
    """Of the torch tensors: cpu, cuda, or cuda:1 and so on."""
    yardsticks: bool = True
    """Whether to measure the other power-flow libraries that are installed."""
    json: Path | None = None
    """File for the figures, if they are wanted as JSON too."""


@dataclass(frozen=True)
class Case:
    """Loads of a batch of one feeder, (lane, bus), and their exact voltages."""

    feeder: Feeder
    v0_pu: float
    p_kw: FloatArray
    q_kvar: FloatArray
    v_pu: FloatArray

    @classmethod
    def draw(cls, scenario: Scenario, lanes: int) -> Case:
        """The scenario's feeder with its own load, each bus's times 0.5 to 1.5 at random, and its capacitors."""
        feeder, rng = scenario.feeder, np.random.default_rng(0)
        p_kw = feeder.p_load_kw * rng.uniform(0.5, 1.5, (lanes, feeder.n_bus))
        q_kvar = feeder.q_load_kvar * rng.uniform(0.5, 1.5, (lanes, feeder.n_bus)) - feeder.capacitor_kvar
        return cls._exact(feeder, scenario.v0_pu, p_kw, q_kvar)

    def changed(self) -> Case:
        """The same with every lane's loads up or down by ``CHANGE``."""
        factor = 1.0 + CHANGE * np.random.default_rng(1).choice([-1.0, 1.0], (len(self.p_kw), 1))
        return self._exact(self.feeder, self.v0_pu, self.p_kw * factor, self.q_kvar * factor)

    @classmethod
    def _exact(cls, feeder: Feeder, v0_pu: float, p_kw: FloatArray, q_kvar: FloatArray) -> Case:
        exact = distflow(feeder, p_kw, q_kvar, v0_pu, tolerance_kva=EXACT_KVA)
        if not exact.converged.all():
            raise ValueError(f"feeder {feeder.name!r} cannot carry the loads drawn for it")
        return cls(feeder, v0_pu, p_kw, q_kvar, exact.v_pu)

    def error_pu(self, v_pu: Any) -> float:
        """Worst difference to the exact voltages of the first lanes, as many as given."""
        return float(np.abs(np.asarray(v_pu) - self.v_pu[: len(v_pu)]).max())

    def singles(self) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Loads of some lanes, one after the other."""
        return zip(self.p_kw[:SINGLES], self.q_kvar[:SINGLES], strict=True)


def environment_rows(scenario: Scenario, cfg: Speed) -> Iterator[Row]:
    """Steps of the environments. A call is a whole episode, so that each block has its share of resets."""
    steps = scenario.horizon
    yield Row("parallel_env", rate(_parallel_episode(scenario), steps, cfg.seconds), "steps/s")
    yield Row("gymnasium.make", rate(_single_episode(scenario), steps, cfg.seconds), "steps/s")
    yield Row("rgb_array, a step each", rate(_single_episode(scenario, "rgb_array"), steps, cfg.seconds), "frames/s")
    per_s = rate(_batch_episode(scenario, cfg.batch), steps * cfg.batch, cfg.seconds)
    yield Row(f"DcgridVectorEnv, {cfg.batch} lanes", per_s, "environment steps/s")
    yield Row(f"DcgridVectorEnv, {cfg.batch} lanes", per_s * scenario.n_agents, "agent steps/s")


def _parallel_episode(scenario: Scenario) -> Callable[[], object]:
    from dcgrid_env import parallel_env

    env, rng = parallel_env(scenario), np.random.default_rng(0)
    sizes = {agent: env.action_space(agent).shape for agent in env.possible_agents}
    drawn = [
        {agent: rng.uniform(-1.0, 1.0, size).astype(np.float32) for agent, size in sizes.items()}
        for _ in range(scenario.horizon)
    ]
    env.reset(seed=0)

    def episode() -> None:
        for action in drawn:
            env.step(action)
            if not env.agents:
                env.reset()

    return episode


def _single_episode(scenario: Scenario, render_mode: str | None = None) -> Callable[[], object]:
    import gymnasium

    from dcgrid_env import IDS

    id_of = {name: registered for registered, name in IDS.items()}
    env, rng = gymnasium.make(id_of[scenario.name], render_mode=render_mode), np.random.default_rng(0)
    drawn = rng.uniform(-1.0, 1.0, (scenario.horizon, *(env.action_space.shape or ()))).astype(np.float32)
    env.reset(seed=0)

    def episode() -> None:
        for action in drawn:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
            if render_mode is not None:
                env.render()

    return episode


def _batch_episode(scenario: Scenario, lanes: int) -> Callable[[], object]:
    from dcgrid_env import DcgridVectorEnv

    env, rng = DcgridVectorEnv(lanes, scenario), np.random.default_rng(0)
    drawn = rng.uniform(-1.0, 1.0, (16, *(env.action_space.shape or ()))).astype(np.float32)
    env.reset(seed=0)

    def episode() -> None:
        for _, action in zip(range(scenario.horizon), itertools.cycle(drawn), strict=False):
            env.step(action)  # a lane that is done begins anew in the same step

    return episode


def power_flow_rows(case: Case, cfg: Speed) -> Iterator[Row]:
    """The power flow alone: batches from a cold and a warm start, linearised, in torch; one feeder from Python."""
    lanes, loads, v0 = len(case.p_kw), (case.p_kw, case.q_kvar), case.v0_pu
    changed = case.changed()

    def timed(name: str, against: Case, solve: Callable[[], Solution]) -> Row:
        return Row(name, rate(solve, lanes, cfg.seconds), "power flows/s", against.error_pu(solve().v_pu))

    cold = distflow(case.feeder, *loads, v0)
    yield timed(f"distflow, {lanes} feeders, cold start", case, lambda: distflow(case.feeder, *loads, v0))
    yield timed(
        f"distflow, {lanes} feeders, warm start, loads {CHANGE:.1%} off",
        changed,
        lambda: distflow(changed.feeder, changed.p_kw, changed.q_kvar, v0, warm=cold),
    )
    name = f"lindistflow, {lanes} feeders (its error is the model's)"
    yield timed(name, case, lambda: lindistflow(case.feeder, *loads, v0))
    if find_spec("torch") is not None:
        import torch

        p_kw, q_kvar = torch.tensor(case.p_kw), torch.tensor(case.q_kvar)
        name = f"distflow, {lanes} feeders, cold start, torch tensors on the CPU"
        yield timed(name, case, lambda: distflow(case.feeder, p_kw, q_kvar, v0))
    yield from _single_rows(case, changed, cfg)


def _single_rows(case: Case, changed: Case, cfg: Speed) -> Iterator[Row]:
    feeder, v0 = case.feeder, case.v0_pu
    starts = [distflow(feeder, p, q, v0) for p, q in case.singles()]
    v_cold = [start.v_pu for start in starts]
    v_warm = [distflow(feeder, p, q, v0, warm=w).v_pu for (p, q), w in zip(changed.singles(), starts, strict=True)]
    cold = itertools.cycle(case.singles())
    warm = itertools.cycle([(p, q, w) for (p, q), w in zip(changed.singles(), starts, strict=True)])

    def solve_cold() -> None:
        p_kw, q_kvar = next(cold)
        distflow(feeder, p_kw, q_kvar, v0)

    def solve_warm() -> None:
        p_kw, q_kvar, start = next(warm)
        distflow(feeder, p_kw, q_kvar, v0, warm=start)

    per_s = rate(solve_cold, 1, cfg.seconds)
    yield Row("distflow, one feeder, cold start", per_s, "power flows/s", case.error_pu(v_cold))
    took_us = 1e6 / rate(solve_warm, 1, cfg.seconds)
    yield Row("distflow, one feeder, warm start", took_us, "µs", changed.error_pu(v_warm))


def memory_row(cfg: Speed) -> Row:
    """Growth of a fresh process by one large batch."""
    if find_spec("resource") is None:
        return Row(f"resident memory of {cfg.lanes} lanes", None, "not measured on this system")
    code = (
        "import sys; from dcgrid_env.speed.rates import resident_growth_mib as grown; "
        "print(grown(sys.argv[1], int(sys.argv[2])))"
    )
    command = [sys.executable, "-c", code, cfg.scenario, str(cfg.lanes)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"the process that measures memory failed: {done.stderr.strip()}")
    mib = float(done.stdout)
    return Row(f"resident memory of {cfg.lanes} lanes ({1024 * mib / cfg.lanes:.1f} KiB each)", mib, "MiB")


def resident_growth_mib(scenario: str, lanes: int) -> float:
    """By how many MiB this process grows with a batch that has taken some steps; measure it in a fresh process."""
    from dcgrid_env import DcgridVectorEnv

    def stepped(n: int) -> object:
        env = DcgridVectorEnv(n, scenario)
        env.reset(seed=0)
        for _ in range(4):
            env.step(np.zeros(env.action_space.shape or (), dtype=np.float32))
        return env

    for n in (1, 256):  # imports, compiled code and threads are no part of a lane
        stepped(n)
    gc.collect()
    before = _resident_mib()
    kept = stepped(lanes)
    gc.collect()
    after = _resident_mib()
    del kept
    return after - before


def _resident_mib() -> float:
    """What this process holds in memory now; where the system does not tell, the most it ever held."""
    import resource  # not on every system

    statm = Path("/proc/self/statm")
    if statm.exists():
        return int(statm.read_text().split()[1]) * resource.getpagesize() / 2**20
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


def yardstick_rows(case: Case, cfg: Speed) -> Iterator[Row]:
    """The other libraries on the same feeder and loads: one after the other and, where they can, as a batch."""
    for name, (build, _) in YARDSTICKS.items():
        if missing(name):
            yield Row(name, None, MISSING)
            continue
        try:
            yardstick = build(case.feeder, case.v0_pu)
        except ImportError as error:  # a release that lacks what we call
            yield Row(name, None, f"cannot be imported: {error}")
            continue
        yield _single_yardstick(yardstick, case, cfg)
        if yardstick.solve_batch is not None:
            work = partial(yardstick.solve_batch, case.p_kw, case.q_kvar)
            per_s = rate(work, len(case.p_kw), cfg.seconds)
            yield Row(f"{yardstick.name}, {len(case.p_kw)} feeders", per_s, "power flows/s", case.error_pu(work()))


def _single_yardstick(yardstick: Yardstick, case: Case, cfg: Speed) -> Row:
    error = case.error_pu([yardstick.solve(p, q) for p, q in case.singles()])
    turns = itertools.cycle(case.singles())
    per_s = rate(lambda: yardstick.solve(*next(turns)), 1, cfg.seconds)
    return Row(f"{yardstick.name}, one feeder", per_s, "power flows/s", error)


def measure(cfg: Speed) -> Iterator[Row]:
    """Every line of the table. ValueError for a setting that cannot be."""
    counts = {"batch": cfg.batch, "feeders": cfg.feeders, "lanes": cfg.lanes}
    if not cfg.seconds > 0.0 or min(counts.values()) < 1:
        raise ValueError(f"seconds is {cfg.seconds} and {counts}; give more than 0 s and at least 1 of each")
    scenario = make_scenario(cfg.scenario)
    tensors = tensor_rows(scenario, cfg.device, cfg.seconds)
    yield from environment_rows(scenario, cfg)
    yield from tensors
    case = Case.draw(scenario, cfg.feeders)
    yield from power_flow_rows(case, cfg)
    yield memory_row(cfg)
    if cfg.yardsticks:
        yield from yardstick_rows(case, cfg)


def about() -> dict[str, Any]:
    """Versions and machine: those of every result, the other libraries' and the processor's name besides."""
    known = meta()
    known["versions"] |= versions(PACKAGES)
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines() if cpuinfo.exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    known["machine"] |= {"processor": models[0] if models else platform.processor(), "threads": n_threads()}
    return known | {"command": " ".join(["python -m dcgrid_env.speed", *sys.argv[1:]])}


def table(rows: list[Row], scenario: str) -> Any:
    """The rows as a table for the terminal."""
    from rich.markup import escape
    from rich.table import Table

    made = Table(title=f"dcgrid, {scenario}", title_justify="left", header_style="bold")
    made.add_column("what")
    made.add_column("figure", justify="right")
    made.add_column("unit")
    made.add_column("worst voltage error, p.u.", justify="right")
    for row in rows:
        figure = "" if row.value is None else f"{row.value:,.0f}" if row.value >= 100 else f"{row.value:.3g}"
        error = "" if row.error_pu is None else f"{row.error_pu:.1e}"
        made.add_row(escape(row.name), figure, escape(row.unit), error)
    return made


def main(args: list[str] | None = None) -> None:
    """Entry point of ``python -m dcgrid_env.speed``; bad input ends with one line on standard error and status 2."""
    import tyro
    from rich.console import Console

    cfg = tyro.cli(Speed, args=args, prog="python -m dcgrid_env.speed", description=__doc__)
    console, rows = Console(), []
    try:
        with console.status("measuring ..."):
            rows.extend(measure(cfg))
        known = about()
        console.print(table(rows, cfg.scenario))
        installed = [f"{package} {number}" for package, number in known["versions"].items() if number is not None]
        console.print(", ".join(installed), highlight=False)
        console.print(", ".join(f"{name} {value}" for name, value in known["machine"].items()), highlight=False)
        if cfg.json is not None:
            settings = {name: value for name, value in asdict(cfg).items() if name != "json"}
            write_json(cfg.json, {"meta": known, "settings": settings, "rows": [asdict(row) for row in rows]})
    except (ValueError, OSError) as error:
        print(f"dcgrid: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
