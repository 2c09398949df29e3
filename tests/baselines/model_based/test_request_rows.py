"""Hindsight under requests of a utility."""

import pytest

from dcgrid_env import make_scenario
from dcgrid_env.baselines import Droop, RequestSharing, make_controller, rollout
from dcgrid_env.baselines.model_based.hindsight import hindsight

SHORT = {"split": "validation", "horizon": 30}
CAP = {"value_share": 0.42, "begin_s": 5, "ramp_s": 5, "duration_s": 15}


@pytest.mark.parametrize("kind", ["cap", "target"])
@pytest.mark.slow
def test_the_program_has_the_environment_s_price_of_a_request(kind):
    s = make_scenario("load-target", grid_request={"targets": [CAP | {"kind": kind}]}, **SHORT)
    found = hindsight(s, 0)
    assert found.bound <= found.J * (1.0 + 1e-4)
    assert found.gap < 0.02 * found.J
    laws = [Droop(), RequestSharing()]
    assert min(float(rollout(s, law, [0]).costs()[0]) for law in laws) > found.J


def test_a_cheap_request_is_missed_and_a_dear_one_is_met():
    cheap, dear = (
        make_scenario("load-target", grid_request={"targets": [CAP]}, weights={"grid_request": weight}, **SHORT)
        for weight in (0.01, 300.0)
    )
    missed, met = (hindsight(s, 0).recorder.metrics()[0] for s in (cheap, dear))
    assert missed["grid_request_delivered_kwh"] < 0.5 * missed["grid_request_asked_kwh"]
    assert met["grid_request_delivered_kwh"] > 0.97 * met["grid_request_asked_kwh"]


@pytest.mark.slow
def test_a_request_far_away_changes_nothing():
    s = make_scenario("load-target", grid_request={"targets": [CAP | {"begin_s": 1000}]}, **SHORT)
    without = s.replace(grid_request={"targets": ()}, weights={"grid_request": 0.0})
    assert pytest.approx(hindsight(without, 1).J, rel=1e-5) == hindsight(s, 1).J


@pytest.mark.parametrize("name", ["mpc", "feedback"])
def test_other_controllers_with_a_model_refuse_its_price(name):
    with pytest.raises(ValueError, match="grid_request"):
        make_controller(name).reset(make_scenario("load-target", observe="feeder"))
