"""The model-aided law without its parts, on random feeders drawn widely, and its time: what docs/model-aided.md shows.

python -m docs.studies.laws.model_aided ablations
python -m docs.studies.laws.model_aided feeders
python -m docs.studies.laws.model_aided taps
OPENBLAS_NUM_THREADS=1 DCGRID_NUM_THREADS=1 python -m docs.studies.laws.model_aided times
"""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any
from unittest.mock import patch

import numpy as np

from dcgrid_env import (
    ActingRelays,
    DcgridVectorEnv,
    Scenario,
    forecast,
    make_scenario,
    own_sensitivity,
    random_feeder,
)
from dcgrid_env.baselines import Controller, Droop, ModelAided, make_controller, rollout
from dcgrid_env.baselines.model_aided.commissioning import commission, site_of

PRESETS = ("ieee33-weak", "das69", "sync", "fault", "zero-shot")
REGULATED = ("ieee13-3ph", "ieee34-3ph", "ieee123-3ph", "ieee123-3ph-day")
SEEDS = range(32)
STYLES = ("urban", "rural", "european-lv", "us-mv")
FEEDERS = range(16)
EPISODES = range(4)
TIMED = ("ieee33-weak", "das69", "ieee123", "fault", "mixed", "scale-32", "zero-shot", "random feeder")
TIMES = 20
STEPS = 50


class WithoutInference(ModelAided):
    """Model-aided law that infers nothing about other buses from the voltage error at its bus."""

    def place(self, buses: np.ndarray) -> None:
        """See ``NeedsPlacement``."""
        super().place(buses)
        assert self._known is not None
        self._known = self._known._replace(gain=0.0 * self._known.gain)


class WithoutDamping(ModelAided):
    """Model-aided law in which each agent accounts only for its own action."""

    def place(self, buses: np.ndarray) -> None:
        """See ``NeedsPlacement``."""
        super().place(buses)
        assert self._known is not None
        alone = self._known.by_q * self.site.q_scale_kvar[:, None]
        by_all = 0.0 * self._known.by_all + alone[:, :, None]
        self._known = self._known._replace(by_all=by_all, alike=1.0 + 0.0 * self._known.alike)


class WithOneDamping(ModelAided):
    """Model-aided law in which all agents use the initial damping of the search."""

    def place(self, buses: np.ndarray) -> None:
        """See ``NeedsPlacement``."""
        super().place(buses)
        assert self._known is not None
        self._known = self._known._replace(alike=self.alike + 0.0 * self._known.alike)


class WithoutAnswers(ModelAided):
    """Each agent takes the others to stand still where it moves."""

    def place(self, buses: np.ndarray) -> None:
        """See ``NeedsPlacement``."""
        super().place(buses)
        assert self._known is not None
        self._known = self._known._replace(by_own=self._known.by_q)


PARTS = {
    "whole": ModelAided(),
    "without inference from the agent's voltage (gain 0)": WithoutInference(),
    "without reactions of other agents (no rounds)": ModelAided(rounds=0),
    "without answers of other agents": WithoutAnswers(),
    "with one damping for all agents (0.8)": WithOneDamping(),
    "without damping": WithoutDamping(),
    "without the pull (hold 0, pull 0)": ModelAided(hold=0.0, pull=0.0),
    "without relief by the clock (price 1e6)": ModelAided(price=1e6),
}


def mean_cost(scenario: Scenario, controller: Controller, seeds: range) -> float:
    """Mean J over episodes."""
    return float(rollout(scenario, controller, seeds).costs().mean())


def ablations() -> None:
    """Print J on validation by preset and part left out."""
    scenarios = [make_scenario(preset, split="validation") for preset in PRESETS]
    print("| | " + " | ".join(PRESETS) + " |", flush=True)
    for name in ("droop-tuned", *PARTS):
        laws = [PARTS.get(name) or make_controller(name, s) for s in scenarios]
        figures = [f"{mean_cost(s, law, SEEDS):.4f}" for s, law in zip(scenarios, laws, strict=True)]
        print(f"| {name} | " + " | ".join(figures) + " |", flush=True)


def drawn(seed: int) -> Scenario:
    """A scenario on a random feeder of any style: number, places and ratings of devices and the source drawn too."""
    rng = np.random.default_rng(seed)
    style = STYLES[rng.integers(4)]
    feeder = random_feeder(1000 + seed, n_bus=int(rng.integers(30, 121)), style=style)
    peak_kw = feeder.p_load_kw.sum()
    n_dc, n_inv = int(rng.integers(1, 7)), int(rng.integers(2, 11))
    p_rated_kw, s_kva = peak_kw * rng.uniform(0.2, 1.5) / n_dc, peak_kw * rng.uniform(0.05, 0.6) / n_inv
    at = rng.permutation(np.flatnonzero(feeder.p_load_kw > 0.0))[: n_dc + n_inv]
    ids = tuple(feeder.bus_ids[i] for i in at)
    return make_scenario(
        "ieee33", name=f"drawn-{seed}", feeder=feeder, source_voltage_pu=rng.uniform(0.95, 1.07), n_datacenters=n_dc,
        datacenters={"buses": ids[:n_dc], "p_rated_kw": p_rated_kw},
        inverters={"buses": ids[n_dc:], "s_rated_kva": s_kva}, split="validation",
    )  # fmt: skip


def droops(scenario: Scenario) -> Iterator[Droop]:
    """Ten droops: five reactive gains, up to twice what the mean X_ii calls for, without and with the clock."""
    x = own_sensitivity(scenario.feeder).by_q_pu_per_mvar
    at = [scenario.feeder.index(bus) for device in scenario.devices for bus in device.buses or ()]
    k_q = float(1.0 / np.mean(x[at]) / len(at))
    for share in (0.1, 0.3, 0.6, 1.0, 2.0):
        for k_p in (0.0, 5.0):
            k_p_mw = k_p * scenario.datacenters.parameters.p_rated_kw.mean() / 1000.0
            yield Droop(k_q_mvar_per_pu_s=share * k_q, k_p_mw_per_pu=k_p_mw)


def feeders() -> None:
    """Print J by feeder under the best of ten droops, MPC of one step and the law, and what the law gains in all."""
    rows = []
    print("| feeder | buses | source, p.u. | sites | best of ten droops | mpc-one-step | model-aided |")
    print("|---|---|---|---|---|---|---|")
    for seed in FEEDERS:
        s = drawn(seed)
        droop = min(mean_cost(s, law, EPISODES) for law in droops(s))
        mpc, law = (mean_cost(s, c, EPISODES) for c in (make_controller("mpc-one-step"), ModelAided()))
        rows.append((droop, mpc, law))
        place = f"{s.feeder.name} | {s.feeder.n_bus} | {s.source_voltage_pu:.3f} | {s.datacenters.count}"
        print(f"| {place} | {droop:.3f} | {mpc:.3f} | {law:.3f} |", flush=True)
    j = np.array(rows)
    print("means:", j.mean(axis=0))
    best = np.minimum(j[:, 0], j[:, 1])
    print("score, ratio of means to the better of droop and MPC:", (j[:, 0] - j[:, 2]).mean() / (j[:, 0] - best).mean())
    print("least gain over the droop, as a share of its J:", ((j[:, 0] - j[:, 2]) / j[:, 0]).min())


def taps() -> None:
    """Print J on validation by preset and the taps at which the moments of commissioning are solved."""
    settled = ActingRelays.settled

    def of_table(relays: ActingRelays, feeder: Any, p_kw: np.ndarray, *_: Any) -> np.ndarray:
        return np.tile(feeder.base_tap, (len(p_kw), 1))

    def without_q(relays: ActingRelays, *load: Any) -> np.ndarray:
        return settled(relays, *load) if len(load) == 4 else load[4]

    print("| | droop-tuned | the feeder's taps | settled without reactive power | settled as in the law |")
    print("|---|---|---|---|---|")
    for name in REGULATED:
        scenario = make_scenario(name, split="validation")
        figures = [mean_cost(scenario, make_controller("droop-tuned", scenario), SEEDS)]
        for taps_of in (of_table, without_q, settled):
            with patch.object(ActingRelays, "settled", taps_of):
                figures.append(mean_cost(scenario, ModelAided(), SEEDS))
        print(f"| `{name}` | " + " | ".join(f"{figure:.4f}" for figure in figures) + " |", flush=True)


def times() -> None:
    """Print CPU time by scenario: moments, the first placement, a following one, and a decision of all agents."""
    print("| | buses | agents | moments, s | first placement, s | a placement, s | a decision of all agents, ms |")
    print("|---|---|---|---|---|---|---|")
    for name in TIMED:
        s = drawn(12) if name == "random feeder" else make_scenario(name)
        s = s.member(0) if name == "zero-shot" else s
        buses = forecast(s, 0).buses[None]
        moments_s, site = cpu_s(lambda s=s: site_of(s))
        first_s, *further_s = [cpu_s(lambda site=site, buses=buses: commission(site, buses))[0] for _ in range(TIMES)]
        figures = f"{moments_s:.3f} | {first_s:.3f} | {min(further_s):.3f} | {1e3 * decision_s(s, buses):.2f}"
        print(f"| {name} | {s.feeder.n_bus} | {s.n_agents} | {figures} |", flush=True)


def decision_s(scenario: Scenario, buses: np.ndarray) -> float:
    """CPU time of a decision of all agents at one step, from their observations to their actions, the least of some."""
    with contextlib.closing(DcgridVectorEnv(1, scenario)) as env:
        observations, _ = env.reset(seed=[0])
        law = ModelAided()
        law.reset(scenario)
        law.place(buses)
        steps_s = []
        for _ in range(STEPS):
            step_s, actions = cpu_s(lambda observations=observations: law.act(observations))
            observations = env.step(actions)[0]
            steps_s.append(step_s)
    return min(steps_s)


def cpu_s(do: Callable[[], Any]) -> tuple[float, Any]:
    """CPU time of a call, and what it gives."""
    began_s = time.process_time()
    done = do()
    return time.process_time() - began_s, done


if __name__ == "__main__":
    {"ablations": ablations, "feeders": feeders, "taps": taps, "times": times}[sys.argv[1]]()
