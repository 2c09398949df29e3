"""Planned taps: the relays' model against power flows, limits of the solver, and what the plan gains in an episode."""

import numpy as np
import pytest

from dcgrid_env import Recorder, acting_relays, field_names, make_scenario
from dcgrid_env.baselines import Droop, rollout
from dcgrid_env.baselines.model_based.linear_model import ModelController
from dcgrid_env.baselines.model_based.lookahead import Program, restarted, solve
from dcgrid_env.baselines.model_based.mpc import Mpc
from dcgrid_env.baselines.model_based.relay_model import relay_model
from dcgrid_env.baselines.model_based.tap_plan import TapPlan


def timed(name="ieee13-3ph-published", timer="integrating", offset_v=0.0, **overrides):
    settings = {"regulator_settings": {"timer": timer, "offset_v": offset_v}}
    return make_scenario(name, split="validation", grid_control=settings, **overrides)


def regulators(recorder: Recorder, env: int = 0):
    return recorder.series(env).three_phase.equipment.regulators


class Steady(ModelController):
    """A constant share of each agent's reactive limit."""

    name = "steady"

    def __init__(self, shares):
        self.shares = np.asarray(shares)

    def plan(self, now):
        return np.full((len(now.v_pu), self.scenario.datacenters.count), 1410.0), np.tile(
            self.shares * self._q_scale, (len(now.v_pu), 1)
        )


@pytest.mark.parametrize("name", ["ieee13-3ph-published", "ieee34-3ph-published"])
def test_the_model_predicts_relay_volts_under_reactive_power(name):
    """Two episodes of the same loads differ by reactive power alone; the model gives the difference to within 10 %."""
    scenario = timed(name, horizon=1, source_voltage_pu=1.0)
    shares = np.linspace(-0.5, 0.8, scenario.n_agents)
    before, after = (rollout(scenario, Steady(s), [3]).series(0) for s in (0.0 * shares, shares))
    relays = acting_relays(scenario)
    assert relays is not None
    assert scenario.datacenters.buses is not None
    buses = np.array([[scenario.feeder.index(bus) for bus in (*scenario.datacenters.buses, *scenario.inverters.buses)]])
    model = relay_model(scenario, relays, buses)
    measured = np.subtract(*(s.three_phase.equipment.regulators.relay_v[-1] for s in (after, before)))
    predicted = (after.q_kvar[-1] - before.q_kvar[-1]) @ model.by_q[0]
    assert np.abs(measured).max() > 0.5
    assert predicted == pytest.approx(measured, abs=0.1 * np.abs(measured).max())


def test_a_tap_moves_relays_and_voltages_as_the_model_has_it():
    """A tap is 0.75 V at its own relay and 0.00625 p.u. downstream."""
    scenario, relays = timed(), acting_relays(timed())
    assert relays is not None
    model = relay_model(scenario, relays, np.array([[5, 6, 7, 8, 9, 10]]))
    assert np.diag(model.by_tap) == pytest.approx(0.75, abs=0.15)
    assert model.v_by_tap.max(axis=1) == pytest.approx(0.00625, abs=0.0015)


def test_a_limit_holds_where_it_is_worth_its_price():
    """The bus needs q = 1 for its voltage; the limit q <= 0.3 holds at a high price and gives way at a low one."""
    one = np.ones((1, 1, 0))
    for price, q in ((300.0, 0.3), (10.0, 1.0)):
        program = Program(
            offset=np.array([[[-0.02, -0.006]]]),
            slopes=np.array([[[0.02, 0.02]]]),
            base=one, low=one, high=one, s_rated=one,
            q_high=np.full((1, 1), 2.0),
            work=one, price=np.zeros((1, 0)),
            voltage=100.0, violation=1000.0, effort=np.zeros(1), band_pu=0.05, n_limits=1, beyond_limit=price,
        )  # fmt: skip
        found = solve(program, None, 500)
        assert found.y[0, 0, 0] == pytest.approx(q, abs=2e-3)
        wider = program._replace(offset=np.array([[[-0.02, -0.014]]]))
        again = restarted(wider, found)
        assert again.e[0, 0, 1] == pytest.approx(0.02 * q - 0.014, abs=1e-4)
        assert solve(wider, again, 500).y[0, 0, 0] == pytest.approx(max(q, 0.7), abs=2e-3)


@pytest.mark.parametrize("timer", ["integrating", "reset"])
@pytest.mark.slow
def test_pushed_relays_make_taps_that_lower_the_cost(timer, monkeypatch):
    """With the published set points, taps down save more than 20 % of the cost of a controller that plans none."""
    scenario = timed(timer=timer)
    planned = rollout(scenario, Mpc(horizon=1), range(2))
    taps = regulators(planned).tap
    assert (taps[-1] <= taps[0] - 2.0).all()
    cost = np.array([episode["J"] for episode in planned.metrics()])
    droop = np.array([episode["J"] for episode in rollout(scenario, Droop(), range(2)).metrics()])
    monkeypatch.setattr(Mpc, "_tap_plan", lambda self, buses: None)
    unplanned = np.array([episode["J"] for episode in rollout(scenario, Mpc(horizon=1), range(2)).metrics()])
    assert (cost < 0.8 * unplanned).all()
    assert (unplanned < droop).all()


@pytest.mark.slow
def test_taps_are_made_when_they_are_planned(monkeypatch):
    """The first tap comes when the delay ends, and nearly all planned taps are made in their step."""
    planned = []
    choose = TapPlan.choose

    def recorded(self, *given):
        planned.append(choose(self, *given))
        return planned[-1]

    monkeypatch.setattr(TapPlan, "choose", recorded)
    tap = regulators(rollout(timed(timer="reset"), Mpc(horizon=1), [0])).tap
    made = np.diff(tap, axis=0)
    asked = np.array([choice.taps[0] for choice in planned])[-len(made) :]
    assert np.flatnonzero(made.any(axis=1))[0] >= 15
    assert np.abs(asked).sum() >= 6
    assert (made == asked)[asked != 0.0].mean() > 0.8


@pytest.mark.slow
def test_relays_whose_timers_integrate_are_held_before_their_delay_ends():
    """Otherwise they are out of band until the end, and a hold that fails then makes a tap that nobody planned."""
    recorder = rollout(make_scenario("ieee13-3ph", split="validation"), Mpc(horizon=1), range(3))
    for env in range(3):
        states = regulators(recorder, env)
        assert (states.out_of_band_s[20:] < 15.0).mean() > 0.95
        assert states.moves[-1].max() <= 2.0


@pytest.mark.slow
def test_no_tap_is_planned_at_a_price_that_it_cannot_save(monkeypatch):
    asked = []
    choose = TapPlan.choose

    def recorded(self, *given):
        choice = choose(self, *given)
        asked.append(choice.taps)
        return choice

    monkeypatch.setattr(TapPlan, "choose", recorded)
    for price, some in ((0.0, True), (1.0, True), (1000.0, False)):
        asked.clear()
        rollout(timed(timer="reset", horizon=30, weights={"switching": price}), Mpc(horizon=1), [0])
        assert np.any(asked) == some


@pytest.mark.slow
def test_an_episode_is_controlled_the_same_alone_and_among_others():
    scenario = timed(horizon=40)
    among = rollout(scenario, Mpc(horizon=2), [0, 1, 2]).series(1)
    alone = rollout(scenario, Mpc(horizon=2), [1]).series(0)
    assert alone.q_kvar == pytest.approx(among.q_kvar, abs=1e-3)


@pytest.mark.parametrize(
    "scenario",
    [
        timed().replace(grid_control={"regulators": "fixed"}),
        timed().replace(grid_control={"regulators": "agent"}),
        make_scenario("ride-through", split="validation"),
    ],
    ids=["fixed", "agents", "sites that trip"],
)
def test_where_no_control_acts_or_sites_trip_there_is_no_plan(scenario):
    controller = Mpc()
    rollout(scenario.replace(horizon=2), controller, [0])
    assert controller._taps is None


def test_without_measurements_of_the_regulators_the_error_names_the_remedy():
    scenario = timed(horizon=2).replace(observe="feeder")
    controller = Mpc()
    controller.reset(scenario)
    n = sum(len(names) for names in field_names(scenario).values())
    with pytest.raises(ValueError, match=r"mpc: the regulators were not measured; call measure\(regulators\)"):
        controller.act(np.zeros((1, n), np.float32))
