"""Daily schedules of set points."""

import numpy as np

from dcgrid_env.devices.tap_changer.regulator_control import RegulatorControl

SETTINGS = RegulatorControl(timer="reset", offset_v={"b": [[6, 1.5], [22.0, -0.5]], "c": 2.0})


def test_an_entry_applies_from_its_hour_until_the_next_and_over_midnight():
    hours = np.array([0.0, 5.999, 6.0, 6.0 - 1e-12, 21.999, 22.0, 30.0, 46.5])
    found = SETTINGS.scheduled_v(("a", "b", "c"), hours)
    assert found[:, 1].tolist() == [-0.5, -0.5, 1.5, 1.5, 1.5, -0.5, 1.5, -0.5]
    assert (found[:, [0, 2]] == 0.0).all()


def test_a_schedule_is_no_part_of_the_constant_offsets():
    assert SETTINGS.offsets_v(("a", "b", "c")) == (0.0, 0.0, 2.0)
    assert SETTINGS.schedules == {"b": ((6, 1.5), (22.0, -0.5))}
    assert RegulatorControl(offset_v=3.0).schedules == {}
