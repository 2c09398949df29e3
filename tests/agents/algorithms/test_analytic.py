"""Training through the physics: what a run writes, that it goes on as it would have, and what it refuses."""

import dataclasses
import json

import numpy as np
import pytest
import torch

from dcgrid_env import make_scenario
from dcgrid_env.agents import Card, Policy
from dcgrid_env.agents.algorithms.analytic import Analytic, Learner, grids_of, main, windows
from dcgrid_env.agents.policy.interface import PolicyInterface
from dcgrid_env.agents.training.config import check
from dcgrid_env.agents.training.normalisation import episode_seeds
from dcgrid_env.agents.training.run_folder import TrainingError, read_curve
from helpers.states import with_fields

TINY = Analytic(
    scenario="toy6", set=("horizon=40",), updates=24, num_envs=16, window=10, hidden=(8,), validation_episodes=4,
    validate_every=2, checkpoint_every=2,
)  # fmt: skip


def without_times(rows):
    return [{name: value for name, value in row.items() if name != "seconds"} for row in rows]


def dying_at(last, how):
    class Dying(Learner):
        """A learner whose run ends in this batch of episodes."""

        def episodes(self, i, iteration, require_finite):
            if iteration == last:
                how(self)
            return super().episodes(i, iteration, require_finite)

    return Dying


def killed(_):
    raise KeyboardInterrupt


def without_gradient(learner):
    next(learner.networks.parameters()).register_hook(lambda slope: slope * float("nan"))


def with_endless_steps(learner):
    learner.optimiser.param_groups[0]["lr"] = float("inf")


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    return main(dataclasses.replace(TINY, out=tmp_path_factory.mktemp("whole") / "run"))


@pytest.mark.slow
def test_a_tiny_run_improves_and_writes_what_it_found(finished):
    curve = read_curve(finished)
    assert [row["step"] for row in curve] == [2, 4, 6]
    best = min(row["J"] for row in curve)
    assert best < 0.95 * curve[0]["J"]
    assert len({row["J_droop"] for row in curve}) == 1
    assert all(np.isfinite(list(row.values())).all() for row in curve)
    assert {"policy.safetensors", "policy.json", "curve.csv", "config.json", "checkpoint.pt"} <= {
        path.name for path in finished.iterdir()
    }
    assert list(finished.glob("events.out.*"))
    config = json.loads((finished / "config.json").read_text())
    assert (config["scenario"], config["updates"], config["hidden"]) == ("toy6", 24, [8])
    card = Card.load(finished / "policy.json")
    assert (card.algorithm, card.scenario, card.seed) == ("analytic", "toy6 --set horizon=40", 0)
    assert card.validation_J == best


@pytest.mark.slow
def test_the_saved_policy_is_the_best_of_the_curve(finished):
    from dcgrid_env.agents.training.validation import Validation

    scenario = make_scenario("toy6", split="validation", horizon=40)
    found = Validation([scenario], 4)(Policy.load(finished / "policy.safetensors"))
    assert found["J"] == pytest.approx(min(row["J"] for row in read_curve(finished)), rel=1e-9)


QUICK = dataclasses.replace(TINY, updates=16, learning_rate=0.08, num_envs=2, hidden=(4,), validation_episodes=2)


@pytest.fixture(scope="module")
def spoilt(tmp_path_factory):
    """A run that grows worse, and its rates of learning."""
    rates = []

    class Spoilt(Learner):
        """From the third batch on every setpoint is driven to its end."""

        def episodes(self, i, iteration, require_finite):
            rates.append(self.optimiser.param_groups[0]["lr"])
            figures = super().episodes(i, iteration, require_finite)
            if iteration > 2:
                with torch.no_grad():
                    for network in self.networks.values():
                        network.layers[-1].bias.fill_(5.0)  # pyright: ignore
            return figures

    return main(dataclasses.replace(QUICK, out=tmp_path_factory.mktemp("spoilt") / "run"), Spoilt), rates


@pytest.mark.slow
def test_the_rate_of_learning_falls_along_a_cosine(spoilt):
    # 40 steps are four windows, so 16 updates are four batches: at 0, 1/4, 1/2 and 3/4 of half a turn.
    assert spoilt[1] == pytest.approx([0.08, 0.04 * (1.0 + np.sqrt(0.5)), 0.04, 0.04 * (1.0 - np.sqrt(0.5))])


@pytest.mark.slow
def test_a_policy_that_grows_worse_is_not_kept(spoilt):
    first, last = (row["J"] for row in read_curve(spoilt[0]))
    assert last > 1.5 * first
    assert Card.load(spoilt[0] / "policy.json").validation_J == first


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on_to_the_same_curve(finished, tmp_path):
    cfg = dataclasses.replace(TINY, out=tmp_path / "run")
    with pytest.raises(KeyboardInterrupt):
        main(cfg, dying_at(4, killed))
    assert [row["step"] for row in read_curve(tmp_path / "run")] == [2]
    main(dataclasses.replace(cfg, resume=True))
    assert without_times(read_curve(tmp_path / "run")) == without_times(read_curve(finished))
    assert (tmp_path / "run" / "policy.safetensors").read_bytes() == (finished / "policy.safetensors").read_bytes()


@pytest.mark.slow
def test_a_run_that_diverges_stops_and_keeps_what_was_good(tmp_path):
    cfg, folder = dataclasses.replace(TINY, out=tmp_path / "run"), tmp_path / "run"
    with pytest.raises(
        TrainingError, match=r"diverged at step 3: a gradient is not finite; the checkpoint in .* before"
    ):
        main(cfg, dying_at(3, without_gradient))
    held = torch.load(folder / "checkpoint.pt", weights_only=True)
    assert held["iteration"] == 2
    assert all(bool(torch.isfinite(a).all()) for a in held["networks"].values())
    Policy.load(folder / "policy.safetensors").reset(make_scenario("toy6"))
    with pytest.raises(TrainingError, match="diverged at step 1: a weight is not finite; no checkpoint yet"):
        main(dataclasses.replace(cfg, out=tmp_path / "other"), dying_at(1, with_endless_steps))


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"view": "centralised"},
        {"preview": False},
        {"act": "q"},
        {"observe": "neighbours"},
        {"history": 2},
        {"history": 3, "view": "centralised", "observe": "feeder"},
    ],
    ids=["shared", "centralised", "no preview", "q only", "neighbours", "history", "central history"],
)
def test_the_exported_policy_acts_as_the_learner_does(settings):
    cfg = dataclasses.replace(TINY, **settings)
    learner = Learner(cfg, grids_of(cfg))
    with torch.no_grad():
        for weight in learner.networks.parameters():
            weight.add_(0.2 * torch.randn_like(weight))
    policy, env = learner.policy(), learner.envs[0]
    policy.reset(env.scenario)
    joint = env.reset(range(5))
    for _ in range(3):
        with torch.no_grad():
            action = learner.act(0, joint)
        np.testing.assert_allclose(policy.act(joint.numpy()), action.numpy(), atol=1e-5)
        assert action.abs().max() > 0.05
        joint = env.step(action).observation


def test_a_run_learns_from_the_training_split_and_from_variants():
    cfg = dataclasses.replace(TINY, scenario="toy6, toy6", vary=2)
    grids = grids_of(cfg)
    assert [grid.split for grid in grids] == ["train"] * 6
    assert (
        grids[2].source_voltage_pu
        != grids[0].source_voltage_pu
        == grids[1].source_voltage_pu
        != grids[4].source_voltage_pu
    )
    again = grids_of(cfg)
    assert [g.inverters.buses for g in grids] == [g.inverters.buses for g in again]
    learner = Learner(cfg, grids[:3])
    assert [type(view) for view in learner.interfaces] == [PolicyInterface] * 3
    figures = learner.episodes(2, 1, lambda what, tensors: None)
    assert np.isfinite(list(figures.values())).all()


@pytest.mark.slow
def test_a_history_begins_with_an_episode_and_is_cut_with_its_windows():
    cfg = dataclasses.replace(QUICK, history=2)
    learner, again = (Learner(cfg, grids_of(cfg)) for _ in range(2))
    figures = learner.episodes(0, 1, lambda what, tensors: None)
    assert all(not a.requires_grad for own in learner.memory.values() for a in own)
    # what an earlier episode left behind does not show
    again.memory = {name: tuple(a + 1.0 for a in own) for name, own in learner.memory.items()}
    assert again.episodes(0, 1, lambda what, tensors: None) == figures
    # three fields of an inverter are remembered, and four of a data centre
    assert {name: len(own[0][0, 0]) for name, own in learner.memory.items()} == {"datacenter": 4, "inverter": 3}
    assert learner.episodes(0, 1, lambda what, tensors: None) != figures


@pytest.mark.parametrize(("limit", "rises"), [(1e-7, True), (1e6, False)])
@pytest.mark.slow
def test_the_price_of_waiting_follows_the_limit_on_delay(limit, rises):
    cfg = dataclasses.replace(TINY, delay_limit_s=limit, dual_rate=0.1, learning_rate=1e-9)
    learner = Learner(cfg, grids_of(cfg))
    with torch.no_grad():  # holds every site back
        learner.networks["datacenter"].layers[-1].bias[0] = 0.5  # pyright: ignore
    found = []
    for iteration in (1, 2):
        learner.episodes(0, iteration, lambda what, tensors: None)
        found.append(learner.factors["delay"])
    # as far off as it counts, by exp(0.1) or exp(-0.1) after each batch
    expected = [np.exp(0.1), np.exp(0.2)] if rises else [np.exp(-0.1), np.exp(-0.2)]
    assert found == pytest.approx(expected, rel=1e-5)
    assert learner.factors["violation"] == 1.0


def test_what_is_left_at_a_windows_end_has_the_price_of_waiting():
    learner = Learner(QUICK, grids_of(QUICK))
    env = learner.envs[0]
    env.reset(range(2))
    step = env.step(torch.zeros(2, 4))
    waiting = step._replace(state=with_fields(step.state, backlog_kws=torch.tensor([[500.0], [1500.0]])))
    plain = env.scenario.cost.weights.leftover * 1000.0 / 2500.0  # the mean backlog over the rating
    for factor in (1.0, 3.0, 0.25):
        learner.factors["delay"] = factor
        assert float(learner._left(env, waiting)) == pytest.approx(factor * plain)


@pytest.mark.parametrize(
    ("horizon", "window", "expected"),
    [(120, 40, [40, 40, 40]), (100, 40, [50, 50]), (100, 33, [33, 33, 34]), (10, 40, [10]), (5, 1, [1] * 5)],
)
def test_windows_by_hand(horizon, window, expected):
    assert windows(horizon, window) == expected


def test_batches_share_no_episode():
    batches = [episode_seeds(seed, i, 7) for seed in (0, 1) for i in (0, 1, 100)]
    assert all(len(batch) == 7 for batch in batches)
    assert len(set().union(*batches)) == 42


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"updates": 0}, "updates is 0; give more than 0"),
        ({"num_envs": -1}, "num_envs is -1"),
        ({"window": 0}, "window is 0"),
        ({"trip_width_pu": -0.1}, "trip_width_pu is -0.1; give at least 0"),
        ({"trip_width_s": 0.0}, "trip_width_s is 0.0; give more than 0"),
        ({"learning_rate": float("nan")}, "learning_rate is nan"),
        ({"max_grad_norm": 0.0}, "max_grad_norm is 0.0"),
        ({"validation_episodes": 0}, "validation_episodes is 0"),
        ({"validate_every": 0}, "validate_every is 0"),
        ({"checkpoint_every": 0}, "checkpoint_every is 0"),
        ({"threads": 0}, "threads is 0"),
        ({"delay_limit_s": 0.0}, "delay_limit_s is 0.0; give more than 0 and at most"),
        ({"violation_limit_pu": -1.0}, "violation_limit_pu is -1.0"),
        ({"seed": -1}, "seed is -1; give at least 0"),
        ({"vary": -1}, "vary is -1; give at least 0"),
        ({"history": -1}, "history is -1; give at least 0 and at most 1000"),
    ],
)
def test_settings_that_cannot_be_are_named(settings, message, tmp_path):
    cfg = dataclasses.replace(TINY, out=tmp_path / "run", **settings)
    with pytest.raises(ValueError, match=message):
        check(cfg)
    with pytest.raises(ValueError, match=message):
        main(cfg)
    assert not (tmp_path / "run").exists()
