"""Power smoothing: GPUs and ramps of a site, a step worked by hand, and what is refused."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dcgrid_env import DataCenters, PowerSmoothing
from dcgrid_env.core.checked import FieldError
from dcgrid_env.devices.datacenter.datacenter import DataCenterState
from dcgrid_env.devices.datacenter.smoothed_site import SmoothedSite

RATED = np.array([1200.0, 600.0])


@pytest.mark.parametrize(
    ("fields", "gpus"),
    [
        ({}, [1000.0, 500.0]),
        ({"gpu_rated_w": 600.0}, [2000.0, 1000.0]),
        ({"gpus": 10.0}, [10.0, 10.0]),
        ({"gpus": (10.0, 20.0)}, [10.0, 20.0]),
    ],
)
def test_gpus_and_ramps(fields: Any, gpus):
    settings = PowerSmoothing(ramp_up_w_per_s=100.0, ramp_down_w_per_s=50.0, **fields)
    np.testing.assert_allclose(settings.gpus_of(RATED), gpus)
    up, down = settings.ramps_kw_per_s(RATED)
    np.testing.assert_allclose(up, 0.1 * np.array(gpus))
    np.testing.assert_allclose(down, 0.05 * np.array(gpus))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"gpu_rated_w": 0.9}, r"gpu_rated_w is 0.9; give a number in \[1, 1e\+06\], or None"),
        ({"gpu_rated_w": 1.1e6}, r"gpu_rated_w is 1100000.0; give a number in"),
        ({"gpus": 5.0, "gpu_rated_w": 700.0}, "gpus is 5.0; give either gpus or gpu_rated_w"),
        ({"floor_share": 0.2}, r"floor_share is 0.2; give more than the idle_share of the sites, 0.2"),
        ({"gpus": 0.5}, r"gpus is 0.5; give one finite number in \[1, 1e\+09\]"),
    ],
)
def test_settings_that_cannot_be_are_refused(fields, message):
    with pytest.raises(FieldError, match=message):
        PowerSmoothing(**fields).check_sites(2, 0.2)


@pytest.mark.parametrize(
    "fields", [{"gpu_rated_w": 1.0}, {"gpu_rated_w": 1e6}, {"gpus": 1.0}, {"floor_share": 0.0}, {"floor_share": 0.21}]
)
def test_the_ends_of_the_ranges_are_allowed(fields):
    PowerSmoothing(**fields).check_sites(2, 0.2)


def stepped(states, p_kw, setpoints: Any = (), dt_s=1.0, **fields):
    """Draw and state of one site of 100 kW and 20 kW idle, of 100 GPUs with a ramp of 10 kW/s up and 5 kW/s down."""
    rule: dict[str, Any] = {
        "floor_share": 0.6,
        "ramp_up_w_per_s": 100.0,
        "ramp_down_w_per_s": 50.0,
        "hysteresis_s": 2.0,
        "gpus": 100.0,
    }
    feature = SmoothedSite(PowerSmoothing(**rule | fields), 1.0)
    params = DataCenters(count=1, p_rated_kw=100.0, s_rated_share=1.1, q_max_share=0.3, idle_share=0.2).parameters
    zero = np.zeros((1, 1))
    state = feature.initial(params, zero)._replace(**{name: zero + value for name, value in states.items()})
    work: Any = SimpleNamespace(work=SimpleNamespace(p_ref_kw=zero + 100.0))
    served = zero + max(p_kw - 20.0, 0.0)
    site = DataCenterState(zero, zero, zero, zero, served, zero, zero, served)
    after, site, drawn = feature.step(params, state, site, zero + p_kw, setpoints, work, dt_s)
    return drawn.item(), {name: value.item() for name, value in after._asdict().items()}, site.served_kw.item()


@pytest.mark.parametrize(
    ("before_kw", "quiet_s", "p_kw", "drawn", "burnt", "held_back", "served", "quiet_after"),
    [
        (-1.0, 0.0, 90.0, 90.0, 0.0, 0.0, 70.0, 0.0),  # nothing limits the first step
        (60.0, 0.0, 90.0, 70.0, 0.0, 20.0, 50.0, 0.0),  # rises by 10 kW
        (70.0, 0.0, 60.0, 65.0, 5.0, 0.0, 40.0, 0.0),  # falls by 5 kW, and the work takes as much as the floor
        (60.0, 0.0, 40.0, 60.0, 20.0, 0.0, 20.0, 1.0),  # the floor outlasts the work
        (60.0, 1.0, 40.0, 60.0, 20.0, 0.0, 20.0, 2.0),
        (60.0, 2.0, 40.0, 55.0, 15.0, 0.0, 20.0, 2.0),  # released
        (42.0, 2.0, 40.0, 40.0, 0.0, 0.0, 20.0, 2.0),
        (5.0, 2.0, 30.0, 20.0, 0.0, 10.0, 0.0, 2.0),  # the idle draw is never held back
    ],
)
def test_a_step_worked_by_hand(before_kw, quiet_s, p_kw, drawn, burnt, held_back, served, quiet_after):
    found_kw, state, served_kw = stepped({"smoothed_kw": before_kw, "quiet_s": quiet_s}, p_kw)
    assert found_kw == pytest.approx(drawn)
    assert state["smoothed_kw"] == pytest.approx(drawn)
    assert (state["burnt_kw"], state["held_back_kw"]) == (pytest.approx(burnt), pytest.approx(held_back))
    assert served_kw == pytest.approx(served)
    assert state["quiet_s"] == pytest.approx(quiet_after)
    assert (state["floor_kw"], state["ramp_up_kw_per_s"], state["ramp_down_kw_per_s"]) == (60.0, 10.0, 5.0)


def test_an_agent_sets_floor_and_ramps_from_time_to_time():
    agent = {"control": "agent", "change_every_s": 3.0}
    setpoints = tuple(np.full((1, 1), value) for value in (0.5, -1.0, np.log10(0.5)))
    first = stepped({}, 60.0, setpoints, **agent)[1]
    assert (first["floor_kw"], first["unchanged_s"]) == (50.0, 0.0)
    assert (first["ramp_up_kw_per_s"], first["ramp_down_kw_per_s"]) == (pytest.approx(1.0), pytest.approx(2.5))
    later = stepped({"smoothed_kw": 60.0}, 60.0, setpoints, **agent)[1]
    assert (later["floor_kw"], later["unchanged_s"]) == (50.0, 2.0)
    kept = stepped({"smoothed_kw": 60.0, "unchanged_s": 1.0, "floor_kw": 30.0}, 60.0, setpoints, **agent)[1]
    assert (kept["floor_kw"], kept["ramp_up_kw_per_s"], kept["unchanged_s"]) == (30.0, 10.0, 0.0)
