"""Every formula, and every function that is bound to a compiled twin, gives the same figures in both forms."""

from importlib import import_module
from pkgutil import walk_packages

import numpy as np
import pytest
import torch

import dcgrid_env
from dcgrid_env import load_feeder
from dcgrid_env.core.formula import ROW_FUNCTIONS, Formula
from dcgrid_env.devices import converter
from dcgrid_env.devices.ride_through import connection
from dcgrid_env.devices.ride_through.rules import RideThrough, UpsRideThrough
from dcgrid_env.devices.ride_through.voltage_curve import RideThroughCurve
from dcgrid_env.devices.tap_changer.regulator_state import initial_regulators
from dcgrid_env.devices.tap_changer.relay import RelayBand, relay_settings

for room in ("devices", "engine", "powerflow"):
    for module in walk_packages([f"{dcgrid_env.__path__[0]}/{room}"], f"dcgrid_env.{room}."):
        if not module.name.endswith("sweep_tensors"):
            import_module(module.name)

ROWS, SLOTS = 60, 4
FUNCTIONS = {name.removeprefix("dcgrid_env."): function for name, function in ROW_FUNCTIONS.items()}


def dispatch(rng):
    rated = rng.uniform(100.0, 900.0, SLOTS)
    p, asked = rng.uniform(-1.2, 1.2, (2, ROWS, SLOTS)) * rated
    return rated, rng.uniform(0.0, 1.0, SLOTS) * rated, p, asked


def serve_linearly(rng):
    rated, ones = rng.uniform(100.0, 900.0, SLOTS), np.ones(SLOTS)
    backlog = rng.uniform(-200.0, 900.0, (ROWS, SLOTS)).clip(0.0)
    f_mhz = rng.uniform(210.0, 1410.0, (ROWS, 2 * SLOTS))[:, ::2]
    f_mhz[:9] = 1410.0
    p_ref = rng.uniform(0.0, 1.2, (ROWS, SLOTS)) * rated
    return 0.23 * rated, 0.77 * rated, 1410.0 * ones, backlog, p_ref, f_mhz, 0.7, bool(rng.integers(2))


def serve_by_slack(rng):
    soon = int(rng.integers(4))
    later = soon + 1 + int(rng.integers(5))
    queue = rng.uniform(-10.0, 30.0, (ROWS, SLOTS, later + 1)).clip(0.0)
    arrived = rng.uniform(-30.0, 100.0, (ROWS, SLOTS)).clip(0.0)
    served = rng.choice([0.0, 0.4, 1.0], (ROWS, SLOTS)) * (arrived + queue.sum(-1))
    moved = rng.uniform(0.0, 1.0, (ROWS, SLOTS)) * arrived if rng.integers(2) else None
    return queue, moved, arrived, served, 1.0, soon, later, rng.random(), bool(rng.integers(2))


def storage(rng):
    energy = rng.uniform(0.01, 10.0, SLOTS)
    figures = (rng.uniform(5.0, 60.0, SLOTS), energy, *rng.uniform(0.3, 1.0, (2, SLOTS)), 0.5 * energy)
    full = rng.uniform(-0.2, 1.2, (ROWS, SLOTS)).clip(0.0, 1.0) * energy
    before = (full, *rng.uniform(0.0, 60.0, (2, ROWS, SLOTS)), *rng.normal(0.0, 5.0, (2, ROWS, SLOTS)))
    connected = rng.integers(0, 2, (ROWS, SLOTS)).astype(float) if rng.integers(2) else None
    return *figures, rng.uniform(0.9, 1.0, SLOTS), *before, rng.normal(0.0, 60.0, (ROWS, SLOTS)), connected, 1.0 / 60.0


def next_taps(rng):
    settings = relay_settings(load_feeder(rng.choice(["ieee13-3ph", "ieee123-3ph"])))
    shape = (ROWS, len(settings.node))
    tap, volts = rng.integers(-16, 17, shape).astype(float), rng.normal(122.0, 4.0, shape)
    waited = rng.uniform(0.0, 20.0, shape)
    state = initial_regulators(tap, volts)._replace(out_of_band_s=waited, in_sequence=(waited < 2.0) * 1.0)
    controlled = rng.integers(0, 2, shape[1]).astype(float) if rng.integers(2) else None
    target_v = rng.normal(122.0, 3.0, state.tap.shape)
    band = RelayBand(target_v, rng.choice([0.4, 1.0, 3.0, np.inf], state.tap.shape))
    left_s, due_s = rng.choice([0.0, 1.0, 30.0], (ROWS, 1)), rng.choice([0.0, 0.5, 20.0, np.inf], (ROWS, 1))
    return settings, state, band, left_s, due_s, bool(rng.integers(2)), controlled


def advance_rows(rng):
    kind, shape = (RideThrough, UpsRideThrough)[rng.integers(2)], (ROWS, 3)
    rule = kind(curve=["itic", "caiso-proposal", RideThroughCurve(over=((1.05, 2.0),))], return_delay_s=2.0)
    state, v, sags, pace = connection.initial(rule, np.zeros(shape)), np.ones(shape), None, np.ones(shape)
    for _ in range(int(rng.integers(1, 40))):
        v = rng.uniform(0.87, 1.12, shape) if rng.random() < 0.2 else np.ones(shape)
        dips = rng.choice([0.0, 0.0, 0.0, 0.05], (ROWS, 2)), *rng.uniform(0.2, 1.0, (2, ROWS, 2))
        sags = np.stack(dips, -1) if rng.integers(2) else None
        pace = rng.choice([0.0, 0.3], shape)
        state = connection.advance(rule, state, connection.Supply(None, v - 0.02, v, sags), pace, 1.0)
    return state, v - 0.02, v, sags, pace, rule.figures(3), None, 1.0


def counted(rng):
    state, _, _, _, _, figures, *_ = advance_rows(rng)
    ages = {name: rng.uniform(0.0, 120.0, getattr(state, name).shape) for name in ("event_age_s", "return_age_s")}
    return state._replace(timer_s=rng.uniform(-2.0, 2.0, state.timer_s.shape).clip(0.0), **ages), figures


def supplied(rng):
    rated = rng.uniform(10.0, 900.0, SLOTS)
    share = rng.choice([0.0, 0.3, 1.0], (ROWS, SLOTS))
    stored = rng.choice([0.0, 0.5, 1.0], (ROWS, SLOTS)) * rng.uniform(0.0, 1.0, (ROWS, SLOTS)) * 30.0 * rated
    p, idle, served = rng.uniform(-0.2, 1.1, (3, ROWS, SLOTS)).clip(0.0) * rated
    return stored, share, p, idle, served, rated, 30.0, 0.1, 0.95, bool(rng.integers(2)), 1.0


def relay_volts(rng):
    settings = relay_settings(load_feeder(rng.choice(["ieee13-3ph", "ieee123-3ph"])))
    return settings, *rng.normal(0.0, 1.0, (2, ROWS, 300)), *rng.normal(0.0, 300.0, (2, ROWS, 300))


def setpoints(rng):
    action = rng.uniform(-1.5, 1.5, (ROWS, 2 * SLOTS))
    return action, *rng.uniform(1.0, 900.0, (2, 2 * SLOTS))


def net_loads(rng):
    n, parts = 12, int(rng.choice([1, 3]))
    at = np.stack([rng.permutation(n)[: SLOTS * parts].reshape(SLOTS, parts) for _ in range(ROWS)])
    p_load, q_load, p, q = (rng.normal(0.0, 50.0, (ROWS, k)) for k in (n, n, SLOTS, SLOTS))
    return p_load, q_load, at + n * np.arange(ROWS)[:, None, None], p, q


INPUTS = {
    "devices.converter:dispatch": dispatch,
    "devices.datacenter.site_kernels:serve_by_slack": serve_by_slack,
    "devices.datacenter.site_work:serve_linearly": serve_linearly,
    "devices.ride_through.connection_kernel:advance_rows": advance_rows,
    "devices.ride_through.connection_kernel:counted": counted,
    "devices.ride_through.ups_battery:_supplied": supplied,
    "devices.storage.energy_balance:_after": storage,
    "devices.tap_changer.tap_kernels:next_taps": next_taps,
    "devices.tap_changer.tap_kernels:relay_volts": relay_volts,
    "engine.physics.dynamics:setpoints": setpoints,
    "engine.physics.step_kernels:net_loads": net_loads,
}
"""Random arguments of each function that runs as a kernel."""
ROUNDED = {"devices.datacenter.site_kernels:serve_by_slack": 1e-9}
"""Pairs that add up in another order, and how far apart they may be."""


def as_tuple(found):
    return (found,) if getattr(found, "ndim", 3) == 2 else found


def test_every_function_with_a_kernel_has_inputs():
    assert set(FUNCTIONS) == set(INPUTS)


@pytest.mark.parametrize("name", INPUTS)
def test_both_forms_give_the_same_figures(name):
    both = FUNCTIONS[name]
    for seed in range(30):
        args = INPUTS[name](np.random.default_rng(seed))
        compiled, arrays = (as_tuple(form(*args)) for form in (both, both.array_form))
        for ours, theirs in zip(compiled, arrays, strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=ROUNDED.get(name, 0.0))
        assert any(np.unique(figures).size > 1 for figures in arrays)


@pytest.mark.parametrize("name", [name for name, function in FUNCTIONS.items() if isinstance(function, Formula)])
def test_formulas_on_tensors(name):
    formula = FUNCTIONS[name]
    for seed in range(5):
        args = INPUTS[name](np.random.default_rng(seed))
        tensors = [torch.tensor(arg) if isinstance(arg, np.ndarray) else arg for arg in args]
        for of_tensors, of_arrays in zip(as_tuple(formula(*tensors)), as_tuple(formula(*args)), strict=True):
            np.testing.assert_allclose(of_tensors.numpy(), of_arrays, rtol=1e-12, atol=1e-12)


def test_what_decides_between_the_forms(monkeypatch):
    monkeypatch.setattr(converter.dispatch, "kernel", lambda *args: "kernel")
    monkeypatch.setattr(converter.dispatch, "array_form", lambda *args: "arrays")
    rows = np.ones((2, 3))
    assert converter.dispatch(rows[0], rows[0], rows, rows) == "kernel"
    for other in (rows[0], rows.astype(np.float32), torch.tensor(rows)):
        assert converter.dispatch(rows[0], rows[0], other, other) == "arrays"


def test_arguments_of_different_shapes():
    rows = np.ones((2, 3))
    for rated, asked in ((np.ones(2), rows), (rows[0], rows[:1])):
        with pytest.raises(ValueError, match="different shapes"):
            converter.dispatch(rated, rows[0], rows, asked)
