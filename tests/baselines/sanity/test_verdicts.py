"""What the figures of a scenario say, each case with its remedy."""

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.baselines.sanity.verdicts import (
    BARE,
    CONSTANT,
    DROOP,
    HINDSIGHT,
    NO_CONTROL,
    PAPER,
    PINNED,
    Figures,
    Reached,
)
from dcgrid_env.baselines.sanity.verdicts import verdicts as said_of


def reached(j, outside=0.0, low=0.96, high=1.04, delay=0.0, converged=1.0, n=4):
    figures = {
        "J": j, "outside_bus_seconds_pct": outside, "voltage_min_pu": low, "voltage_max_pu": high,
        "delay_mean_s": delay, "power_flow_converged": converged,
    }  # fmt: skip
    return Reached.from_metrics([figures] * n)


def said(others, k_q=20.0, refused=""):
    every = {NO_CONTROL: reached(5.0), PAPER: reached(4.0), DROOP: reached(3.5), CONSTANT: reached(3.6), **others}
    found = said_of(make_scenario("ieee33-weak"), Figures(every, "18", refused, k_q, requested_episodes=4))
    return [str(verdict) for verdict in found], any(verdict.is_bar for verdict in found)


def test_much_to_gain_is_worth_learning_and_names_the_figures():
    lines, barred = said({HINDSIGHT: reached(2.8, delay=2.0), PINNED: reached(3.5, n=2)})
    assert not barred
    assert lines[-1] == "ieee33-weak is worth learning on"
    assert "there is much to gain: hindsight is 20.0 % below the best droop (J 2.800 against 3.500), 44 %" in lines[-2]
    assert "the clock matters: it is worth 20.0 % of J to hindsight (work then waits 2.0 s on average)" in lines
    assert "with k_p = 0 the droop is stable up to k_q = 20 Mvar/p.u. s in these episodes" in lines


@pytest.mark.parametrize(
    ("others", "start", "remedy"),
    [
        ({HINDSIGHT: reached(4.95)}, "nothing to gain: hindsight is within 1.0 % of", "raise the data centres'"),
        ({HINDSIGHT: reached(3.45)}, "little is left to learn beyond the best droop: hindsight", "now 3000 kW"),
        ({HINDSIGHT: reached(2.0, 12.0, low=0.9)}, "hopeless: even hindsight leaves the band in 12.0 %", "raise"),
        ({HINDSIGHT: reached(2.0, converged=0.0)}, "hopeless: even hindsight ends 4 of 4 episodes", "lower the data"),
    ],
)  # fmt: skip
def test_what_bars_learning_says_so_with_a_remedy(others, start, remedy):
    lines, barred = said(others)
    assert barred
    assert lines[-1] == "ieee33-weak is not worth learning on as it stands"
    (line,) = [line for line in lines if line.startswith(start)]
    assert remedy in line


@pytest.mark.parametrize(
    ("low", "high", "bare", "remedy"),
    [
        (0.93, 1.03, 0.0, "raise source_voltage_pu from 1.05 to 1.06875"),
        (0.97, 1.07, 0.0, "lower source_voltage_pu from 1.05 to 1.03125"),
        (0.93, 1.048, 0.0, "lower the data centres' rating (datacenters.p_rated_kw, now 3000 kW in all)"),
        (
            0.93,
            1.048,
            4.0,
            "the feeder's own load leaves it in 4.0 % without any data centre: give inverters",
        ),
    ],
)
def test_a_band_that_is_hard_to_keep_gets_another_voltage_or_less_load(low, high, bare, remedy):
    hard = {HINDSIGHT: reached(2.0, outside=5.0, low=low, high=high), BARE: reached(1.0, outside=bare)}
    lines, barred = said(hard)
    assert not barred
    assert lines[0].startswith("hard: even hindsight leaves the band in 5.0 % of bus-seconds")
    assert remedy in lines[0]
    assert ("near bus 18" in lines[0]) == (bare > 0)


def test_a_clock_that_is_worth_nothing_a_low_bound_and_collapses_are_told():
    pinned = {HINDSIGHT: reached(2.8), PINNED: reached(2.8), NO_CONTROL: reached(5.0, converged=0.0)}
    lines, _ = said(pinned, k_q=0.3)
    (clock,) = [line for line in lines if line.startswith("the clock hardly matters: it is worth 0.0 % of J")]
    assert "--act q" in clock
    assert any(
        "k_q = 0.3 Mvar/p.u. s in these episodes, below the paper's 0.5; compare with droop-tuned" in line
        for line in lines
    )
    assert any(line.startswith("without control the power flow has no solution in 4 of 4 episodes;") for line in lines)


def test_without_hindsight_rules_are_judged_and_fewer_episodes_are_told():
    lines, barred = said({}, refused="hindsight plans no trips")
    assert not barred
    assert "hindsight is not known here: hindsight plans no trips; judge by what a trained policy reaches" in lines
    assert lines[-1] == "simple rules are 30.0 % below no control"
    few, _ = said({HINDSIGHT: reached(2.8, n=2)})
    sure = "as far as the first 2 of 4 episodes tell; give it more --seconds to be sure"
    assert few[-1] == f"ieee33-weak is worth learning on, {sure}"


def test_a_mean_may_be_of_the_first_episodes():
    none = Reached.from_metrics(
        [{"J": j, "outside_bus_seconds_pct": 0.0, "power_flow_converged": 1.0} for j in (1.0, 2.0, 6.0)]
    )
    assert none.mean("J", 2) == 1.5
    assert np.isclose(none.mean("J"), 3.0)
