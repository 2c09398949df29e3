"""Per-unit bases, against the same figures in volts, amperes and watts."""

import pytest

from dcgrid_env import load_feeder
from dcgrid_env.grid.per_unit import S_BASE_KVA, impedance_base_ohm


@pytest.mark.parametrize("base_kv", [0.4, 1.0, 4.16, 12.66, 110.0])
def test_impedance_base_is_volts_squared_over_volt_amperes(base_kv):
    assert impedance_base_ohm(base_kv) == pytest.approx((1e3 * base_kv) ** 2 / (1e3 * S_BASE_KVA), rel=1e-14)


def test_impedance_base_of_the_named_feeders_worked_by_hand():
    # 1 MVA on every feeder: 12.66^2, 4.16^2 and 1^2 ohm.
    assert S_BASE_KVA == 1000.0
    assert impedance_base_ohm(12.66) == pytest.approx(160.2756, abs=1e-10)
    assert impedance_base_ohm(4.16) == pytest.approx(17.3056, abs=1e-10)
    assert impedance_base_ohm(load_feeder("toy6").base_kv) == 1.0
