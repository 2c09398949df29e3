"""Offsets of set points by regulator or bank, and daily schedules."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import load_feeder
from dcgrid_env.core.checked import FieldError
from dcgrid_env.devices.tap_changer.regulator_control import RegulatorControl

TABLE = load_feeder("ieee123-3ph").network.regulator
"""creg1a, creg2a, creg3a, creg4a, creg3c, creg4b, creg4c of the banks reg1a, reg2, reg3 and reg4."""
OFFSETS: Any = {"reg2": [[6, 1.5], [22.0, -0.5]], "reg4": 2.0, "creg4b": -1.0}
SETTINGS = RegulatorControl(timer="reset", offset_v=OFFSETS)


def test_an_entry_applies_from_its_hour_until_the_next_and_over_midnight():
    hours = np.array([0.0, 5.999, 6.0, 6.0 - 1e-12, 21.999, 22.0, 30.0, 46.5])
    found = SETTINGS.scheduled_v(TABLE, hours)
    assert found[:, 1].tolist() == [-0.5, -0.5, 1.5, 1.5, 1.5, -0.5, 1.5, -0.5]
    assert (found[:, [0, *range(2, 7)]] == 0.0).all()


def test_a_schedule_is_no_part_of_the_constant_offsets():
    assert SETTINGS.has_schedules
    assert SETTINGS.offsets_v(TABLE).tolist() == [0.0, 0.0, 0.0, 2.0, 0.0, -1.0, 2.0]
    everywhere = RegulatorControl(offset_v=3.0)
    assert not everywhere.has_schedules
    assert everywhere.offsets_v(TABLE).tolist() == [3.0] * 7


@pytest.mark.parametrize(
    "value", [12.0, -12, 0, {"reg4": -12.0}, {"reg4": [[0.0, 12.0]]}, {"reg4": [[0, 1], [23.9, 2]]}]
)
def test_offsets_up_to_12_v_and_hours_of_a_day_are_allowed(value):
    RegulatorControl(offset_v=value)


@pytest.mark.parametrize(
    "value",
    [12.1, -12.1, "1", {"reg4": 12.1}, {"reg4": []}, {"reg4": [[24.0, 1.0]]}, {"reg4": [[-0.1, 1.0]]},
     {"reg4": [[True, 1.0]]}, {"reg4": [[1.0, 1.0], [1.0, 2.0]]}, {"reg4": [[2.0, 1.0], [1.0, 2.0]]},
     {"reg4": [[1.0, -12.1]]}, {"reg4": [[1.0, 1.0, 1.0]]}, [["reg4"]], {"reg4": [1.0, 2.0]}],
    ids=str,
)  # fmt: skip
def test_other_offsets_are_refused(value):
    with pytest.raises(
        FieldError, match=r"RegulatorControl: offset_v is .*; give volts between -12 and 12, or a mapping"
    ):
        RegulatorControl(offset_v=value)
