"""Devices that change the grid itself: their switching acts on the power flow, or is refused by name."""

from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest
import torch

from dcgrid_env import DcgridVectorEnv, Inverters, PowerFlowError, TensorEnv, make_scenario
from dcgrid_env.devices import Channel, GridChange
from helpers.three_phase import ieee13


class _Switched(NamedTuple):
    on_kvar: Any


_INVERTERS: Any = Inverters  # whose state and channels a subclass of the tests has otherwise


class _SwitchedShunts(_INVERTERS):
    """Capacitor banks in four steps, at the buses of inverters that inject nothing themselves."""

    kind: ClassVar[str] = "shunt"
    prefix: ClassVar[str] = "cap"
    input: ClassVar[str | None] = None
    changes_grid: ClassVar[bool] = True

    @property
    def q_limit_kvar(self):
        return np.zeros(self.count)

    @property
    def channels(self):
        rated = self.parameters.s_rated_kva
        return (Channel("switch", "kvar", 0.0 * rated, rated, rest=0.0 * rated),)

    def initial(self, parameters, zero):
        return _Switched(zero)

    def step(self, parameters, state, setpoints, device_input, dt_s):
        on = 0.25 * (4.0 * setpoints[0] / parameters.s_rated_kva).round() * parameters.s_rated_kva
        return _Switched(on), 0.0 * on

    def grid_change(self, parameters, state):
        return GridChange(shunt_kvar=state.on_kvar)


class _Taps(_SwitchedShunts):
    kind: ClassVar[str] = "tap"

    def grid_change(self, parameters, state):
        return GridChange(tap_ratio=1.0 + 0.0 * state.on_kvar)


def scenario(kind):
    base = make_scenario("toy6", background={"load_sigma": 0.0})
    return base.replace(devices=(base.devices[0], kind(buses=("3", "5"), s_rated_kva=400.0)))


def test_what_is_switched_injects_as_an_inverter_would():
    env = DcgridVectorEnv(4, scenario(_SwitchedShunts))
    env.reset(seed=[0] * 4)
    action = np.zeros((4, 4))
    action[:, 2] = [-1.0, -0.4, 0.1, 1.0]  # 0, 120, 220 and 400 kvar asked for at bus 3
    action[:, 3] = -1.0
    env.step(action)
    state = env.transition.state
    np.testing.assert_allclose(state.on_kvar[:, 0], [0.0, 100.0, 200.0, 400.0])
    np.testing.assert_allclose(state.q_kvar[:, 1:], 0.0)
    base = make_scenario("toy6", background={"load_sigma": 0.0})
    inverters = Inverters(buses=("3", "5"), s_rated_kva=400.0)
    other = DcgridVectorEnv(4, base.replace(devices=(base.devices[0], inverters)))
    other.reset(seed=[0] * 4)
    action[:, 2] = [0.0, 0.25, 0.5, 1.0]
    action[:, 3] = 0.0
    other.step(action)
    np.testing.assert_allclose(state.v_pu, other.transition.state.v_pu, atol=1e-12)


def test_tensors_switch_too():
    env = TensorEnv(scenario(_SwitchedShunts), like=torch.empty(0, dtype=torch.float64))
    env.reset([0])
    step = env.step(torch.tensor([[1.0, 0.0, 1.0, 0.0]], dtype=torch.float64))
    np.testing.assert_allclose(step.state.on_kvar.numpy(), [[400.0, 200.0]])


def test_a_tap_without_a_regulator_is_refused():
    env = DcgridVectorEnv(1, scenario(_Taps))
    with pytest.raises(PowerFlowError, match=r"tap_ratio is .*, and a balanced feeder has no regulator"):
        env.reset(seed=0)


def test_a_shunt_at_a_bus_of_three_phases_or_of_one():
    base = ieee13().replace(horizon=4)
    buses = {"buses": ("675", "611"), "s_rated_kva": 100.0}
    voltages = []
    for group, asked in ((_SwitchedShunts(**buses), 1.0), (Inverters(**buses), 1.0)):
        env = DcgridVectorEnv(1, base.replace(devices=(base.devices[0], group)))
        env.reset(seed=0)
        env.step(np.array([[1.0, 0.0, 1.0, 0.0, asked, asked]]))
        voltages.append(env.transition.state.v_pu)
    np.testing.assert_allclose(voltages[0], voltages[1], atol=1e-8)
