"""Figures of storages: defaults, ranges, cost terms and metrics, worked by hand."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import Storages
from dcgrid_env.core.checked import FieldError
from dcgrid_env.devices.storage import figures
from dcgrid_env.devices.storage.energy_balance import StorageState

GIVEN: dict[str, Any] = {"buses": (1, 2), "p_rated_kw": (100.0, 300.0), "energy_kwh": (50.0, 30.0)}
RANGES = {
    "charge_efficiency": (0.95, 0.01, 1.0),
    "discharge_efficiency": (0.95, 0.01, 1.0),
    "standby_share_per_h": (0.0, 0.0, 0.99),
    "initial_share": (0.5, 0.0, 1.0),
    "returned_share": (1.0, 0.01, 1.0),
    "ageing_price": (0.02, 0.0, 1e6),
    "missing_price": (9.0, 1e-3, 1e6),
}


@pytest.mark.parametrize("name", RANGES)
def test_default_and_range_of_a_figure(name):
    default, low, high = RANGES[name]

    def with_value(value: Any) -> Any:
        given: dict[str, Any] = GIVEN | {name: value}
        return getattr(Storages(**given), name)

    assert getattr(Storages(**GIVEN), name) == default
    for value in (low, high, (low, high)):
        assert with_value(value) == value
    for value in (low - 1e-4, high * 1.001, (low, high * 1.001)):
        with pytest.raises(FieldError, match=f"Storages: {name} is .*; give one finite number in "):
            with_value(value)


def test_terms_and_fields_worked_by_hand():
    given = {"initial_share": 0.4, "returned_share": 0.5, "missing_price": (2.0, 3.0), "ageing_price": (0.1, 0.3)}
    storages = Storages(**GIVEN | given)
    params = storages.parameters
    np.testing.assert_allclose(params.initial_kwh, [20.0, 12.0])
    np.testing.assert_allclose(params.returned_kwh, [10.0, 6.0])
    ageing, missing = storages.cost_terms(10, 1.0)
    assert (ageing.team_scale, ageing.largest, ageing.at_end, ageing.weight) == (400.0, 0.3, False, 1.0)
    assert (missing.team_scale, missing.at_end, missing.weight) == (pytest.approx(400.0 / 3600.0), True, 1.0)
    assert missing.largest == pytest.approx(2.0 * 10.0 * 3600.0 / 100.0)
    np.testing.assert_allclose(ageing.own_scale, [100.0, 300.0])
    np.testing.assert_allclose(missing.own_scale, np.array([100.0, 300.0]) / 3600.0)
    assert [(f.name, f.lowest, f.highest, f.share_of.tolist()) for f in storages.fields(10, 1.0)] == [
        ("stored", 0.0, 1.0, [50.0, 30.0]),
        ("charge_limit", 0.0, 1.0, [100.0, 300.0]),
        ("discharge_limit", 0.0, 1.0, [100.0, 300.0]),
    ]


def test_figures_of_no_storage_are_zero_or_one():
    none = Storages(buses=(), p_rated_kw=1.0, energy_kwh=1.0)
    ageing, missing = none.cost_terms(10, 1.0)
    assert (ageing.team_scale, ageing.largest, missing.largest) == (1.0, 0.0, 0.0)
    assert missing.team_scale == pytest.approx(1.0 / 3600.0)


def test_metrics_and_totals_of_a_history_worked_by_hand():
    params = Storages(**GIVEN).parameters
    over_time = np.array([[20.0, 10.0], [8.0, 8.0], [24.0, 16.0]])
    history = StorageState(
        stored_kwh=over_time, storage_kw=over_time, charge_limit_kw=over_time, discharge_limit_kw=over_time,
        throughput_kwh=over_time / 2.0, storage_loss_kwh=over_time / 4.0, missing_kwh=over_time[::-1] / 8.0,
    )  # fmt: skip
    assert figures.metrics(params, history, "x_") == pytest.approx(
        {
            "x_stored_end_pct": 50.0,
            "x_stored_lowest_pct": 20.0,
            "x_storage_throughput_kwh": 5.0,
            "x_storage_loss_kwh": 2.5,
            "x_storage_missing_kwh": 30.0 / 8.0,
        }
    )
    totals = figures.totals(StorageState(*(values[1:2] for values in history)), "x_")
    assert {name: value.tolist() for name, value in totals.items()} == {
        "x_stored_kwh": [16.0],
        "x_storage_throughput_kwh": [8.0],
        "x_storage_loss_kwh": [4.0],
        "x_storage_missing_kwh": [2.0],
    }
    state = StorageState(*(-values[:1] for values in history))
    np.testing.assert_allclose(figures.amount("ageing", params, state), [[0.4, 0.2]])
    np.testing.assert_allclose(figures.amount("site_missing", params, state), [[-27.0, -18.0]])


def test_the_converter_of_a_storage_with_and_without_reactive_power():
    without, with_q = Storages(**GIVEN), Storages(**GIVEN, s_rated_kva=(110.0, 400.0))
    np.testing.assert_array_equal(without.converter_kva, [100.0, 300.0])
    np.testing.assert_array_equal(without.q_limit_kvar, [0.0, 0.0])
    for figures_kva in (with_q.converter_kva, with_q.q_limit_kvar):
        np.testing.assert_array_equal(figures_kva, [110.0, 400.0])
    assert Storages(**GIVEN, s_rated_kva=(100.0, 300.0)).count == 2
    assert with_q.largest_draw_share == 1.0
    (p,), (_, q) = without.channels, with_q.channels
    np.testing.assert_array_equal([p.lowest, p.highest, p.rest], [[-100, -300], [100, 300], [0, 0]])
    np.testing.assert_array_equal([q.lowest, q.highest, q.rest], [[-110, -400], [110, 400], [0, 0]])


def test_sizes_have_the_figures_of_their_sources():
    rack, ups, bess = Storages.supercapacitors((1,), 1000.0), Storages.ups((1,), 60.0), Storages.bess((1,), 60.0)
    names = ("p_rated_kw", "energy_kwh", "charge_efficiency", "discharge_efficiency", "standby_share_per_h")
    found = [[getattr(each.parameters, name).item() for name in names] for each in (rack, ups, bess)]
    one_way = 0.85**0.5
    np.testing.assert_allclose(
        found,
        [
            [420.0, 65_000.0 / 3.6e6, 0.98, 0.98, 0.01],
            [60.0, 5.0, 0.96, 0.96, 3e-5],
            [60.0, 120.0, one_way, one_way, 3e-5],
        ],
    )
    assert [each.initial_share for each in (rack, ups, bess)] == [0.5, 1.0, 0.5]
    assert [each.ageing_price for each in (rack, ups, bess)] == [0.0, 0.05, 0.02]
