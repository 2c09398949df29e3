"""Cost of the information that the model-aided law lacks, on validation episodes: the tables of decision 15.

The law is given one true quantity after the other in place of its estimate, and other constants. Hindsight and one-step
MPC bound the result.

python -m docs.studies.laws.missing_information quantities
python -m docs.studies.laws.missing_information constants
"""

import sys
from typing import ClassVar

import numpy as np

from dcgrid_env import Scenario, field_names, make_scenario
from dcgrid_env.agents import find_controller
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.baselines import Controller, Local, ModelAided, make_controller, rollout
from dcgrid_env.baselines.model_aided.knowledge import Commissioned, resting
from dcgrid_env.baselines.model_aided.law_step import LawStep, Own
from dcgrid_env.baselines.model_based.hindsight import hindsight
from docs.studies.learning.feeder_by_feeder import on_each_feeder

PRESETS = ("das69", "zero-shot")
SEEDS = range(16)
PARTS = ("J", "cost_voltage", "cost_violation", "cost_backlog", "cost_leftover", "cost_effort")
EPISODES = 16
"""Episodes of ``zero-shot`` whose feeders are driven."""
EACH = 4
SETTINGS = ("hold=0.0", "hold=0.03", "hold=0.1", "hold=0.2", "price=1.5", "price=3.0", "alike=0.4")


class Informed(ModelAided):
    """Model-aided law in which each agent has the voltages of all buses, and with ``draws`` the coming draws of all.

    For one level of the sun and measurements without noise and delay.
    """

    observe: ClassVar[str] = "feeder"

    def __init__(self, draws: bool):
        super().__init__()
        self._draws = draws

    def _local(self, joint: np.ndarray) -> Local:
        flat, s = joint.reshape(-1, joint.shape[-1]).astype(np.float64), self.scenario
        width = len(field_names(s)[s.agents[0]])
        self._v_pu = 1.0 + s.cost.band_pu * flat[:, width - len(s.feeder.load_nodes) : width]
        return super()._local(joint)

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """See ``LocalController``."""
        step = self._step
        assert step is not None
        self._step = LawStep(self._site, self._informed(local, step), np.asarray)
        try:
            return super().control(local)
        finally:
            self._step = step

    def _informed(self, local: Local, step: LawStep) -> Commissioned:
        """The agents' data with the true voltages as the estimate, one placement a row."""
        v, n_row = self._v_pu, len(self._v_pu)
        known = step.known if len(step.known.mean_kw) == n_row else step.known.take(np.zeros(n_row, int))
        flat = Own(*(getattr(local, field).reshape(n_row, -1) for field in Own._fields))
        (idle_kw, all_kw, _), kvar = step.work(flat), flat.q_kvar
        next_kw = flat.p_kw.copy()
        next_kw[:, : self.scenario.datacenters.count] = idle_kw + all_kw
        if self._past.steps == 0:  # agents act as if they stood at u*
            rest_kvar = resting(self._site, known, next_kw)
            v, kvar = v + np.einsum("mn,mnk->mk", rest_kvar - kvar, known.by_q), rest_kvar
        base = v[:, None] - known.by_q * (kvar - known.origin_kvar)[..., None]
        base = base + known.by_p * (flat.p_kw - known.mean_kw)[..., None]
        if self._draws:
            coming = known.by_p * (next_kw - flat.p_kw)[..., None]
            base = base - coming.sum(axis=1, keepdims=True) + coming
        return known._replace(
            base_pu=base[:, :, None],
            gain=0.0 * known.gain,
            by_draw=known.by_p,
            inverse_spread=0.0 * known.inverse_spread + 1.0 / self.floor_pu,
        )


def quantities() -> None:
    """Print the parts of J and the score by preset and information."""
    for preset in PRESETS:
        scenario = make_scenario(preset, split="validation")
        droop = _parts(scenario, make_controller("droop-tuned", scenario))
        best = np.mean([_of(hindsight(scenario, seed).recorder.metrics()[0]) for seed in SEEDS], axis=0)
        controllers: dict[str, Controller] = {
            "law": ModelAided(),
            "carry-over": find_controller("carry-over", scenario),
            "law with the voltages of all buses": Informed(draws=False),
            "law with these and the coming draws of all sites": Informed(draws=True),
            "mpc-messages": make_controller("mpc-messages"),
            "mpc-one-step": make_controller("mpc-one-step"),
        }
        print(f"| {preset} | score | {' | '.join(part.removeprefix('cost_') for part in PARTS)} |")
        print(f"|---|{'---|' * (1 + len(PARTS))}", flush=True)
        every = {"droop-tuned": droop, **{name: _parts(scenario, one) for name, one in controllers.items()}}
        for name, parts in (every | {"hindsight": best}).items():
            score = (droop[0] - parts[0]) / (droop[0] - best[0])
            print(f"| {name} | {score:.2f} | {' | '.join(f'{part:.4f}' for part in parts)} |", flush=True)


def constants() -> None:
    """Print scores over the feeders of zero-shot by the constants of the law, and those of the best choice for each."""
    laws = [f"dcgrid_env.baselines:ModelAided({setting})" for setting in SETTINGS]
    names = ("model-aided", "carry-over", *laws)
    driven = on_each_feeder(names, "zero-shot", "validation", EPISODES, EACH)
    scores = np.array([[on.score(name) for name in names] for on in driven])
    print(f"{len(driven)} feeders, {EACH} episodes each\n| law | mean score | lowest |\n|---|---|---|")
    best = {"the better of law and carry-over": scores[:, :2].max(1), "the best of all": scores.max(1)}
    for name, each in (dict(zip(names, scores.T, strict=True)) | best).items():
        print(f"| {name} | {each.mean():.3f} | {each.min():.2f} |")


def _parts(scenario: Scenario, controller: Controller) -> np.ndarray:
    with on_purpose():
        return np.mean([_of(metrics) for metrics in rollout(scenario, controller, SEEDS).metrics()], axis=0)


def _of(metrics: dict[str, float]) -> list[float]:
    return [metrics[part] for part in PARTS]


if __name__ == "__main__":
    {"quantities": quantities, "constants": constants}[sys.argv[1]]()
