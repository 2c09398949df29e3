"""What banks measure, and their delays, worked by hand."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from dcgrid_env.devices.capacitor_bank.bank_measurements import (
    CURRENT,
    KVAR,
    POWER_FACTOR,
    VOLTAGE,
    BankSettings,
    measured,
)
from dcgrid_env.devices.capacitor_bank.bank_switching import Thresholds, bank_delays, initial_banks, next_switchings
from dcgrid_env.devices.tap_changer.relay import settings_like

V: Any = np.array([[1.0 + 0.1j, -0.5 - 0.8j, 0.2 + 0.9j]])
I: Any = np.array([[3.0 - 4.0j, 1.0 + 1.0j, -2.0 + 0.5j]])
MEAN, HIGHEST, LOWEST = 0.0, 1.0, 2.0


def settings_of(n=1, **changes: Any) -> BankSettings:
    """Banks of one place at node 0, which switch on below 0.95 after 4 s, and off above 1.05 after 7 s."""
    one, zero = np.ones(n), np.zeros(n)
    node = np.zeros(n, np.int64)
    fields = {
        "measures": zero, "node": node, "other": node, "is_between": np.zeros((n, 1)), "volts_of": zero,
        "meter_node": node, "fed_node": node, "sign": np.ones((n, 1)), "charging_node": np.zeros(3 * n, np.int64),
        "charging_a_per_pu": np.zeros((n, 1, 3)), "amps_of": zero, "kvar_per_pu_a": 2.0 * one,
        "least_kvar": zero - math.inf, "on_at": 0.95 * one, "off_at": 1.05 * one, "is_low": one,
        "low_pu": zero - math.inf, "high_pu": zero + math.inf, "delay_on_s": 4.0 * one, "delay_off_s": 7.0 * one,
        "dead_time_s": 20.0 * one, "before": np.arange(n), "behind": np.arange(n),
    }  # fmt: skip
    return BankSettings(**fields | changes)


def measured_by(settings, on=0.0):
    solution: Any = SimpleNamespace(v_re_pu=V.real, v_im_pu=V.imag, v_pu=np.abs(V), i_re_a=I.real, i_im_a=I.imag)
    v_pu, value = measured(settings, solution, np.full((1, len(settings.measures)), on))
    return v_pu[0, 0], value[0, 0]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_current_power_and_power_factor_of_one_place(sign):
    power = 2.0 * V[0, 0] * np.conj(sign * I[0, 0])
    factor = abs(power.real) / abs(power)
    expected = {
        VOLTAGE: abs(V[0, 0]),
        CURRENT: 5.0,
        KVAR: power.imag,
        POWER_FACTOR: factor if power.imag > 0.0 else 2.0 - factor,
    }
    for measures, value in expected.items():
        settings = settings_of(measures=np.array([float(measures)]), sign=np.array([[sign]]))
        assert measured_by(settings) == pytest.approx((abs(V[0, 0]), value))


def test_the_voltage_between_two_nodes():
    settings = settings_of(other=np.array([2]), is_between=np.ones((1, 1)))
    assert measured_by(settings)[0] == pytest.approx(abs(V[0, 0] - V[0, 2]))


@pytest.mark.parametrize(("statistic", "of"), [(MEAN, np.mean), (HIGHEST, np.max), (LOWEST, np.min)])
@pytest.mark.parametrize("measures", [VOLTAGE, CURRENT])
def test_statistics_of_several_places(statistic, of, measures):
    settings = settings_of(
        measures=np.array([float(measures)]), node=np.arange(3), other=np.arange(3), is_between=np.zeros((1, 3)),
        meter_node=np.arange(3), fed_node=np.arange(3), sign=np.ones((1, 3)), charging_node=np.zeros(9, np.int64),
        charging_a_per_pu=np.zeros((1, 3, 3)), volts_of=np.array([statistic]), amps_of=np.array([statistic]),
    )  # fmt: skip
    v_pu, value = measured_by(settings)
    assert v_pu == pytest.approx(of(np.abs(V)))
    assert value == pytest.approx(of(np.abs(V if measures == VOLTAGE else I)))


def test_power_of_several_places_is_their_mean_in_the_unit_of_the_bank():
    settings = settings_of(
        measures=np.array([float(KVAR)]), meter_node=np.arange(3), fed_node=np.array([1, 2, 0]),
        sign=np.array([[1.0, -1.0, 1.0]]), charging_node=np.zeros(9, np.int64),
        charging_a_per_pu=np.zeros((1, 3, 3)), kvar_per_pu_a=np.array([6.0]),
    )  # fmt: skip
    currents = np.array([1.0, -1.0, 1.0]) * I[0, [1, 2, 0]]
    assert measured_by(settings)[1] == pytest.approx(2.0 * (V[0] * np.conj(currents)).imag.sum())


def test_charging_leads_the_voltage_by_a_quarter_of_a_period():
    amps_per_pu = np.array([[[2.0, 1.0, 0.5]]])
    settings = settings_of(
        measures=np.array([float(CURRENT)]), charging_node=np.arange(3), charging_a_per_pu=amps_per_pu
    )
    assert measured_by(settings)[1] == pytest.approx(abs(I[0, 0] + 1j * (amps_per_pu[0, 0] * V[0]).sum()))


@pytest.mark.parametrize(("on", "least_kvar", "counts"), [(0.0, 10.0, True), (1.0, 10.0, False), (0.0, 1.0, False)])
def test_too_little_reactive_power_does_not_switch_on_by_its_power_factor(on, least_kvar, counts):
    settings = settings_of(measures=np.array([float(POWER_FACTOR)]), least_kvar=np.array([least_kvar]))
    power = 2.0 * V[0, 0] * np.conj(I[0, 0])  # 5.2 kW and 8.6 kvar: a factor of 0.517
    factor = abs(power.real) / abs(power)
    assert measured_by(settings, on)[1] == pytest.approx(0.95 if counts else factor)


def test_without_power_the_factor_is_one():
    settings = settings_of(measures=np.array([float(POWER_FACTOR)]), kvar_per_pu_a=np.zeros(1))
    assert measured_by(settings)[1] == 1.0


def delays(settings, on, value, **fields):
    state = initial_banks(np.array([on], np.float64))
    values = np.array([value], np.float64)
    return bank_delays(settings, state._replace(v_pu=values, value=values, **fields))[0].tolist()


def test_banks_begin_at_nominal_voltage_with_nothing_counted():
    state = initial_banks(np.array([[0.0, 1.0]]))
    np.testing.assert_array_equal(state.v_pu, [[1.0, 1.0]])
    for figures in (state.value, state.beyond_s, state.since_s, state.switched, state.switchings):
        np.testing.assert_array_equal(figures, [[0.0, 0.0]])


def test_delays_before_switching_on_and_off():
    two = settings_of(2)
    assert delays(two, [0, 1], [0.94, 1.06]) == [4.0, 7.0]
    assert delays(two, [0, 1], [0.95, 1.05]) == [math.inf, math.inf]
    assert delays(two, [1, 0], [0.94, 1.06]) == [math.inf, math.inf]
    assert delays(two, [0, 1], [0.94, 1.06], beyond_s=np.array([[1.0, 2.5]])) == [3.0, 4.5]
    assert delays(two, [0, 1], [0.94, 1.06], beyond_s=np.array([[5.0, 8.0]])) == [0.0, 0.0]


def test_a_bank_that_has_switched_waits_out_its_dead_time_before_it_switches_on():
    two, since_s = settings_of(2), np.array([[5.0, 5.0]])
    assert delays(two, [0, 0], [0.9, 0.9], since_s=since_s) == [4.0, 4.0]
    switched = {"since_s": since_s, "switchings": np.array([[1.0, 0.0]])}
    assert delays(two, [0, 0], [0.9, 0.9], **switched) == [19.0, 4.0]
    assert delays(two, [1, 1], [1.1, 1.1], **switched) == [7.0, 7.0]


def test_a_bank_switches_on_after_and_off_before_its_neighbour():
    two = settings_of(2, before=np.array([0, 0]), behind=np.array([1, 1]))
    assert delays(two, [0, 0], [0.9, 0.9]) == [4.0, math.inf]
    assert delays(two, [1, 0], [0.9, 0.9]) == [math.inf, 4.0]
    assert delays(two, [1, 1], [1.1, 1.1]) == [math.inf, 7.0]
    assert delays(two, [1, 0], [1.1, 1.1]) == [7.0, math.inf]


def test_voltages_beyond_their_limits_switch_in_any_case_and_high_controls_the_other_way():
    by_power = settings_of(is_low=-np.ones(1), on_at=np.array([5.0]), off_at=np.array([-5.0]))
    assert delays(by_power, [0], [5.1]) == [4.0]
    assert delays(by_power, [0], [4.9]) == [math.inf]
    assert delays(by_power, [1], [-5.1]) == [7.0]
    limits: dict[str, Any] = {"low_pu": np.array([-1.0]), "high_pu": np.array([2.0])}
    limited = settings_of(is_low=-np.ones(1), on_at=np.array([5.0]), off_at=np.array([-5.0]), **limits)
    assert delays(limited, [0], [-1.0]) == delays(limited, [1], [2.0]) == [math.inf]
    assert delays(limited, [0], [-1.5]) == [4.0]
    assert delays(limited, [1], [2.5]) == [7.0]


def test_thresholds_of_an_agent_replace_those_of_the_settings():
    state = initial_banks(np.array([[0.0, 1.0]]))._replace(value=np.array([[1.0, 1.0]]))
    thresholds = Thresholds(np.array([[1.01, 0.9]]), np.array([[1.2, 0.99]]))
    assert bank_delays(settings_of(2), state, None, thresholds).tolist() == [[4.0, 7.0]]
    assert bank_delays(settings_of(2), state, np.array([1.0, 0.0]), thresholds).tolist() == [[4.0, math.inf]]


def test_time_passes_for_banks_that_wait_and_ends_for_those_that_switch():
    state = initial_banks(np.array([[0.0, 1.0, 1.0]]))._replace(
        beyond_s=np.array([[1.0, 2.0, 3.0]]),
        since_s=np.array([[9.0, 9.0, 9.0]]),
        switchings=np.array([[1.0, 0.0, 0.0]]),
    )
    delay_s = np.array([[3.0, 5.0, math.inf]])
    after = next_switchings(state, delay_s, np.array([[3.0]]), np.array([[True]]))
    np.testing.assert_array_equal(after.on, [[1.0, 1.0, 1.0]])
    np.testing.assert_array_equal(after.beyond_s, [[0.0, 5.0, 0.0]])
    np.testing.assert_array_equal(after.since_s, [[0.0, 12.0, 12.0]])
    np.testing.assert_array_equal(after.switched, [[1.0, 0.0, 0.0]])
    np.testing.assert_array_equal(after.switchings, [[2.0, 0.0, 0.0]])
    waits = next_switchings(state, delay_s, np.array([[3.0]]), np.array([[False]]))
    np.testing.assert_array_equal(waits.on, state.on)
    np.testing.assert_array_equal(waits.beyond_s, [[4.0, 5.0, 0.0]])


def solution_of(fields) -> Any:
    """A solution with some of its fields."""
    return SimpleNamespace(**dict(fields))


@pytest.mark.parametrize("measures", [VOLTAGE, CURRENT, KVAR, POWER_FACTOR])
def test_tensors_measure_the_same(measures):
    settings = settings_of(
        3, measures=np.full(3, float(measures)), node=np.arange(3), other=np.array([1, 1, 2]),
        is_between=np.array([[1.0], [0.0], [0.0]]), meter_node=np.arange(3), fed_node=np.arange(3),
        charging_node=np.arange(9) % 3, charging_a_per_pu=np.arange(9.0).reshape(3, 1, 3), least_kvar=np.full(3, 2.0),
        volts_of=np.array([MEAN, HIGHEST, LOWEST]), amps_of=np.array([LOWEST, MEAN, HIGHEST]),
    )  # fmt: skip
    v: Any = np.vstack((V, 0.9 * V))
    i: Any = np.vstack((I, 1.1j * I))
    arrays = v.real, v.imag, np.abs(v), i.real, i.imag
    on, names = np.array([[0.0, 1.0, 0.0]] * 2), ("v_re_pu", "v_im_pu", "v_pu", "i_re_a", "i_im_a")
    found = measured(settings, solution_of(zip(names, arrays, strict=True)), on)
    tensors = solution_of((name, torch.from_numpy(values.copy())) for name, values in zip(names, arrays, strict=True))
    like = torch.zeros(0, dtype=torch.float64)
    on_tensors = measured(settings_like(settings, like), tensors, torch.from_numpy(on))
    for tensor, array in zip(on_tensors, found, strict=True):
        np.testing.assert_allclose(tensor.numpy(), array, rtol=1e-14)
