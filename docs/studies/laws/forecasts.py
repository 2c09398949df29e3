"""The value of one-second forecasts for one-step control that observes the whole feeder.

Model predictive control over one step measures every voltage, has a model of the feeder and observes the next demand
of every site. This study replaces its forecast of the other loads and of PV. The score is that of the benchmark.

    python -m docs.studies.laws.forecasts mixed toy6 --split test --episodes 100
"""

import argparse

import numpy as np

from dcgrid_env import Scenario, distflow, forecast, make_scenario
from dcgrid_env.baselines import make_controller, published, rollout
from dcgrid_env.baselines.model_based.hindsight import hindsight
from dcgrid_env.baselines.model_based.linear_model import Estimate
from dcgrid_env.baselines.model_based.lookahead import Program
from dcgrid_env.baselines.model_based.mpc import Mpc

LOADS = ("stay", "their mean course", "known")
"""Forecasts of the loads: unchanged, returning to the mean of their process, or exact."""
PV = ("stays", "goes on as it moved", "known")


class Informed(Mpc):
    """One-step control of some episodes with a chosen forecast."""

    def __init__(self, loads: str, pv: str, seeds: range):
        super().__init__(horizon=1)
        self.loads, self.pv, self.seeds = loads, pv, seeds

    def reset(self, env_info: Scenario) -> None:
        """See :class:`Mpc`."""
        super().reset(env_info)
        courses = [forecast(self.scenario, seed) for seed in self.seeds]
        self._p_kw, self._q_kvar, self._pv_kw = (
            np.stack([getattr(course, field) for course in courses])
            for field in ("p_load_kw", "q_load_kvar", "p_inverter_kw")
        )
        self._buses = np.stack([course.buses for course in courses])
        self._k = 0

    def _program(self, now: Estimate, p_ref_kw: np.ndarray) -> Program:
        program, k = super()._program(now, p_ref_kw), self._k
        self._k += 1
        if k == 0:  # a course begins at the first step, so that nothing is known yet of where it comes from
            return program
        s, before = self.scenario, max(k - 2, 0)
        p, q, pv = ((a[:, before], a[:, k - 1], a[:, k]) for a in (self._p_kw, self._q_kvar, self._pv_kw))
        mean_kw, mean_kvar = (
            s.feeder.p_load_kw,
            s.feeder.q_load_kvar - s.background.capacitors * s.feeder.capacitor_kvar,
        )
        kept = s.background.load_rho**s.dt_s
        ahead = {
            "stay": (p[1], q[1]),
            "their mean course": (mean_kw + kept * (p[1] - mean_kw), mean_kvar + kept * (q[1] - mean_kvar)),
            "known": (p[2], q[2]),
        }[self.loads]
        pv_ahead = {"stays": pv[1], "goes on as it moved": 2.0 * pv[1] - pv[0], "known": pv[2]}[self.pv]
        moved = self._voltages(now, ahead[0], ahead[1], pv_ahead) - self._voltages(now, p[1], q[1], pv[1])
        return program._replace(offset=program.offset + moved[:, None])

    def _voltages(self, now: Estimate, p_kw: np.ndarray, q_kvar: np.ndarray, pv_kw: np.ndarray) -> np.ndarray:
        """Return voltages at these loads and this PV, p.u., (row, n_load_node); sites and reactive power are fixed."""
        s, p, q = self.scenario, p_kw.copy(), q_kvar.copy()
        rows = np.arange(len(p))[:, None]
        drawn = np.concatenate((now.local.p_kw[:, : s.datacenters.count], -pv_kw), axis=1)
        np.add.at(p, (rows, self._buses), drawn)
        np.add.at(q, (rows, self._buses), -now.local.q_kvar)
        return np.asarray(distflow(s.feeder, p, q, s.source_voltage_pu).v_pu)[:, s.feeder.load_slice]


def main() -> None:
    """Print a row for each forecast."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("presets", nargs="+")
    parser.add_argument("--split", default="test")
    parser.add_argument("--episodes", type=int, default=100)
    given = parser.parse_args()
    seeds = range(given.episodes)
    print("| preset | the sites' next draw | other loads | PV | score |\n|---|---|---|---|---|")
    for name in given.presets:
        scenario = make_scenario(name, split=given.split)
        shipped = published(scenario)
        best = shipped.select(list(seeds)).J if shipped else [hindsight(scenario, seed).J for seed in seeds]
        droop = cost(scenario, make_controller("droop-tuned", scenario), seeds)
        sun = any(np.ptp(forecast(scenario, seed).p_inverter_kw) > 0.0 for seed in seeds[:3])
        cases = [(scenario, loads, pv) for loads in LOADS for pv in (PV if sun else PV[:1])]
        for on, loads, pv in [(scenario.replace(sensing={"preview": False}), "stay", "stays"), *cases]:
            score = (droop - cost(on, Informed(loads, pv, seeds), seeds)) / (droop - np.mean(best))
            seen = "seen" if on.sensing.preview else "not seen"
            print(f"| `{name}` | {seen} | {loads} | {pv if sun else ''} | {score:.3f} |")


def cost(scenario: Scenario, controller: object, seeds: range) -> float:
    """Mean J."""
    run = rollout(scenario, controller, seeds)  # pyright: ignore[reportArgumentType]
    return float(np.mean([metrics["J"] for metrics in run.metrics()]))


if __name__ == "__main__":
    main()
