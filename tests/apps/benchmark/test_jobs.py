"""Units: division of work, stored results, and the identity of controllers."""

import numpy as np
import pytest
import scipy.special

from dcgrid_env import make_scenario, scenario_hash
from dcgrid_env.agents import Network, Policy
from dcgrid_env.apps.benchmark import jobs
from dcgrid_env.apps.benchmark.jobs import UNIT_EPISODES, V_EDGES_PU, Case, Task, Unit, controller_hash, plan, run
from dcgrid_env.baselines import ConstantQ, Droop, NoControl, rollout
from dcgrid_env.baselines.scenario_spec import ScenarioSpec

TOY6 = Case(ScenarioSpec("toy6"))


def task(controller, first, episodes):
    """A unit of toy6 with its scenario."""
    form = scenario_hash(TOY6.scenario())
    return Task(Unit("toy6", controller, first, episodes, form, "b", "c"), TOY6)


def test_units_cover_the_seeds_once():
    tasks, failures = plan([TOY6], ["none", "droop"], 2 * UNIT_EPISODES + 3)
    units = [task.unit for task in tasks]
    assert failures == {}
    for name in ("none", "droop"):
        own = [unit for unit in units if unit.controller == name]
        assert [seed for unit in own for seed in unit.seeds] == list(range(2 * UNIT_EPISODES + 3))
        assert len({unit.scenario_hash for unit in own}) == len({unit.controller_hash for unit in own}) == 1
    assert plan([TOY6], ["none"], 4)[0][0].unit == units[0].__class__("toy6", "none", 0, 4, *_rest(units[0]))


def _rest(unit: Unit):
    return unit.scenario_hash, unit.controller_hash, unit.version


def test_a_units_record_is_its_episodes_and_all_its_voltages():
    record = run(task("droop", 4, 3))
    recorder = rollout(make_scenario("toy6", split="test"), Droop(), [4, 5, 6])
    for i, (found, expected) in enumerate(zip(record["episodes"], recorder.metrics(), strict=True)):
        assert found == {"scenario": "toy6", "controller": "droop", "episode": 4 + i, "seed": 4 + i, **expected}
    assert record["unit"]["controller_hash"] == "b"
    assert record["observes"] == "local"
    counts = record["voltage"]["counts"]
    assert sum(counts) == 3 * 100 * 5
    v = np.concatenate([recorder.series(i).v_pu[1:, 1:].ravel() for i in range(3)])
    first = record["voltage"]["first_bin"]
    assert V_EDGES_PU[first] <= v.min() < V_EDGES_PU[first + 1]
    assert V_EDGES_PU[first + len(counts) - 1] <= v.max() < V_EDGES_PU[first + len(counts)]
    expected, _ = np.histogram(v, V_EDGES_PU)
    assert counts == expected[first : first + len(counts)].tolist()


class Refusing(NoControl):
    def reset(self, env_info):
        raise ValueError("needs\na crystal ball " + 400 * "x")


class Leaving(NoControl):
    def act(self, observations):
        raise SystemExit(7)


@pytest.mark.parametrize(
    ("controller", "text"),
    [(Refusing, "does not apply: needs a crystal ball x"), (Leaving, "failed in act, test_jobs.py line")],
)
def test_a_refusal_and_a_failure_are_one_line(monkeypatch, controller, text):
    monkeypatch.setattr(jobs, "find_controller", lambda spec, scenario, tuned: controller())
    failure = run(task("x", 0, 1))["failure"]
    assert failure.startswith(text)
    assert len(failure.splitlines()) == 1
    assert len(failure) < 330


def test_a_wider_scope_and_places_pass_through_and_are_told(monkeypatch):
    seen = {}

    class Wide(NoControl):
        observe = "feeder"

        def place(self, buses):
            seen["buses"] = buses

        def act(self, observations):
            seen["width"] = observations.shape[-1]
            return super().act(observations)

    monkeypatch.setattr(jobs, "find_controller", lambda spec, scenario, tuned: Wide())
    record = run(task("x", 0, 2))
    assert record["observes"] == "feeder, feeder's model"
    assert seen["buses"].shape == (2, 3)
    assert seen["width"] == 9 + 2 * 7 + 3 * 5


def test_the_hash_of_a_controller_follows_its_parameters():
    assert controller_hash(Droop()) == controller_hash(Droop())
    hashes = [
        Droop(),
        Droop(k_p_mw_per_pu=2.0),
        NoControl(),
        ConstantQ(0.5),
        ConstantQ((0.5, 0.4)),
        ConstantQ((0.5, 0.3)),
    ]
    assert len(set(map(controller_hash, hashes))) == len(hashes)
    one, two = NoControl(), NoControl()
    one.gain = two.gain = np.arange(3.0)  # type: ignore[attr-defined]
    one.itself, two.itself = one, two  # type: ignore[attr-defined]
    assert controller_hash(one) == controller_hash(two)
    two.gain = np.arange(3.0) + 1e-12  # type: ignore[attr-defined]
    assert controller_hash(one) != controller_hash(two)


def policy(q_share):
    return Policy({"inverter": Network([(np.zeros((7, 1)), [q_share])])})


class Slotted:
    __slots__ = ("figure",)

    def __init__(self, figure):
        self.figure = figure


class ForeignArray:
    """As another library's: no attributes, but a way to a list."""

    __slots__ = ("_hidden",)

    def __init__(self, figures):
        self._hidden = iter(figures)

    def tolist(self):
        return list(self._hidden)


@pytest.mark.parametrize(
    "hold",
    [
        policy,
        lambda x: policy(x).networks["inverter"],
        lambda x: policy(x).act,
        lambda x: {"nets": [policy(x)]},
        lambda x: {x, 7.0},
        lambda x: np.array([policy(x), None]),
        Slotted,
        lambda x: ForeignArray([x, 1.0]),
    ],
)
def test_the_hash_reaches_what_a_controller_holds(hold):
    def controller(x):
        made = NoControl()
        made.held = hold(x)  # type: ignore[attr-defined]
        return made

    assert controller_hash(controller(0.5)) == controller_hash(controller(0.5))
    assert controller_hash(controller(0.5)) != controller_hash(controller(0.25))
    assert controller_hash(policy(0.5)) == controller_hash(policy(0.5))
    assert controller_hash(policy(0.5)) != controller_hash(policy(0.25))


def test_code_that_a_controller_holds_is_fed_by_its_name():
    def controller(*held):
        made = NoControl()
        made.held = held  # type: ignore[attr-defined]
        return made

    one, two = (controller(np, np.tanh, len, Slotted, f) for f in (policy, test_units_cover_the_seeds_once))
    assert controller_hash(one) == controller_hash(controller(np, np.tanh, len, Slotted, policy))
    assert controller_hash(one) != controller_hash(two)
    assert controller_hash(one) != controller_hash(controller(np, np.maximum, len, Slotted, policy))
    assert controller_hash(controller(scipy.special.expit)) != controller_hash(controller(scipy.special.erf))


def test_another_policy_under_the_same_name_is_another_unit(tmp_path):
    path = tmp_path / "mine.safetensors"
    found = []
    for q_share in (0.5, 0.5, 0.25):
        policy(q_share).save(path)
        found.append(plan([Case(ScenarioSpec("ieee123"))], [str(path)], 2)[0][0].unit)
    assert found[0] == found[1]
    assert found[0].controller_hash != found[2].controller_hash
    held = policy(0.25)
    before = controller_hash(held, str(path))
    Policy(held.networks, made_with="another command").save(path)
    assert controller_hash(held, str(path)) != before  # the file's own bytes
    own = tmp_path / "own.py"
    own.write_text("one = 1")
    before = controller_hash(held, f"{own}:make")
    own.write_text("one = 2")
    assert controller_hash(held, f"{own}:make") != before


def test_constructor_arguments_are_part_of_the_controller(tmp_path):
    own = tmp_path / "own.py"
    own.write_text(
        "class Law:\n    def __init__(self, gain=0.0): ...\n    def reset(self, e): ...\n    def act(self, o): ...\n"
    )
    units = [
        plan([TOY6], [f"{own}:Law{given}"], 2)[0][0].unit for given in ("", "(gain=0.5)", "(gain=0.25)", "(gain=0.50)")
    ]
    hashes = [unit.controller_hash for unit in units]
    assert len(set(hashes)) == 3
    assert hashes[1] == hashes[3]


def test_a_scenario_that_is_another_in_each_process_fails(tmp_path):
    own = tmp_path / "own.py"
    own.write_text("from dcgrid_env import make_scenario\ndef make(): return make_scenario('toy6', name='mine')\n")
    (task,), _ = plan([Case(ScenarioSpec(f"{own}:make"))], ["none"], 2)
    assert "episodes" in run(task)
    own.write_text(own.read_text().replace("'mine'", "'mine', background={'load_sigma': 0.1}"))
    assert run(task)[
        "failure"
    ] == f"failed: {own}:make gives another scenario in each process; let it draw nothing " + (
        "at random, or from a fixed seed"
    )


def test_one_name_is_told_apart_by_its_overrides():
    units = [plan([Case(ScenarioSpec("toy6", given))], ["none"], 2)[0][0].unit for given in ((), ("horizon=30",))]
    assert units[0].scenario == units[1].scenario
    assert units[0].scenario_hash != units[1].scenario_hash
