"""Feeders with an element out of service: what changes in their tables, and in what they carry."""

import dataclasses

import pytest

from dcgrid_env import make_scenario
from dcgrid_env.apps.hosting.capacity_study import Study
from dcgrid_env.apps.hosting.hosting import hosting_capacity
from dcgrid_env.apps.hosting.outages import outage_names, outages_asked, with_outage
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.devices.tap_changer.tap_changers import TapChangers


@pytest.fixture(scope="module")
def scenario():
    return make_scenario("ieee123-3ph", split="test")


def test_single_outages_are_those_of_banks(scenario):
    network = scenario.feeder.network
    names = outage_names(scenario)
    assert names == (
        *(f"capacitor {name}" for name in network.capacitor.name),
        *(f"regulator {bank}" for bank in dict.fromkeys(network.regulator.bank)),
    )
    assert tuple(outages_asked(scenario, ["all", names[0]])) == names
    balanced = make_scenario("ieee33", split="test")
    assert outage_names(balanced) == ()
    with pytest.raises(ValueError, match="feeder 'ieee33' has no capacitor bank in service and no regulators"):
        outages_asked(balanced, ["all"])


def test_tables_change_in_the_rows_of_the_element_alone(scenario):
    network = scenario.feeder.network
    off = with_outage(scenario, f"capacitor {network.capacitor.name[0]}").feeder.network
    assert off.capacitor.state == ("off", *network.capacitor.state[1:])
    bank = network.regulator.bank[-1]
    lost = with_outage(scenario, f"regulator {bank}").feeder.network.regulator
    for row, of in enumerate(network.regulator.bank):
        kept = of != bank
        assert (lost.max_taps_per_move[row] == network.regulator.max_taps_per_move[row]) is kept
        assert lost.tap[row] == (network.regulator.tap[row] if kept else 0)


@pytest.mark.parametrize("modes", ["agent", {"reg4": "setpoint", "reg1a": "agent"}])
def test_agents_cannot_move_a_bank_that_is_out_of_service(scenario, modes):
    before = scenario.replace(grid_control={"regulators": modes})
    after = with_outage(before, "regulator reg4")
    (group,) = [device for device in after.devices if isinstance(device, TapChangers)]
    assert "creg4a" not in group.names
    assert not [device for device in after.devices if device.kind == "regulator_setpoint"]
    everything = " + ".join(f"regulator {bank}" for bank in ("reg1a", "reg2", "reg3", "reg4"))
    assert not [device for device in with_outage(before, everything).devices if device.kind == "tap_changer"]


def test_a_tie_takes_over_behind_an_open_switch(scenario):
    table = scenario.feeder.network.switch
    ties = [name for name, state in zip(table.name, table.state, strict=True) if state == "open"]
    closed = [name for name, state in zip(table.name, table.state, strict=True) if state == "closed"]
    moved = 0
    for name in closed:
        with pytest.raises(ValueError, match=f"'open {name}' leaves a feeder that cannot be solved"):
            with_outage(scenario, f"open {name}")
    for tie in ties:
        for name in closed:
            try:
                other = with_outage(scenario, f"open {name} + close {tie}")
            except ValueError:
                continue
            assert other.feeder.is_radial
            moved += 1
    assert moved


@pytest.mark.slow
def test_without_a_capacitor_less_fits_at_low_voltage(scenario):
    study = Study(
        scenario=scenario, others=False, buses=("66",), samples=1, window_s=10.0, settle_s=4.0, load="peak",
        v_min_pu=0.93, v_max_pu=1.08, max_mw=2.0, tolerance_mw=0.02,
    )  # fmt: skip
    whole = hosting_capacity(study, ["none"]).by_controller["none"][0].capacity_mw
    lost = with_outage(scenario, f"capacitor {scenario.feeder.network.capacitor.name[0]}")
    without = hosting_capacity(dataclasses.replace(study, scenario=lost), ["none"]).by_controller["none"][0].capacity_mw
    assert without <= whole


@pytest.mark.parametrize(
    ("outage", "message"),
    [
        ("capacitor x", "has no capacitor 'x', got 'capacitor x'; there are"),
        ("fuse x", "must be capacitor, regulator, open or close with a name, got 'fuse x'"),
        ("close", "has no switch '', got 'close'"),
    ],
)
def test_outages_that_cannot_be(scenario, outage, message):
    with pytest.raises(ValueError, match=message):
        with_outage(scenario, outage)
    with pytest.raises(ValueError, match="balanced feeder 'ieee33' has no elements"):
        with_outage(make_scenario("ieee33", split="test"), outage)


def test_an_outage_of_a_bank_with_scheduled_set_points_is_possible(scenario):
    schedule = {"offset_v": {"reg4": [(6.0, 0.0), (18.0, 1.5)]}}
    modes = {"reg4": "controlled", "reg1a": "fixed"}
    day = scenario.replace(
        background={"start_hour": 12.0}, grid_control={"regulators": modes, "regulator_settings": schedule}
    )
    table = with_outage(day, "regulator reg4").feeder.network.regulator
    assert {most for bank, most in zip(table.bank, table.max_taps_per_move, strict=True) if bank == "reg4"} == {0}


@pytest.mark.slow
@pytest.mark.parametrize("modes", ["controlled", "agent", "setpoint", {"c83": "controlled", "c90b": "agent"}])
def test_nothing_switches_a_bank_on_that_is_out_of_service(scenario, modes):
    """With thresholds that keep all banks on."""
    settings = {"on_below_pu": 1.4, "off_above_pu": 1.5, "delay_s": 2.0}
    before = scenario.replace(grid_control={"capacitors": modes, "capacitor_settings": settings}, horizon=10)
    after = with_outage(before, "capacitor c83")
    row = scenario.feeder.network.capacitor.name.index("c83")
    on = rollout(after, NoControl(), [0]).series(0).three_phase.equipment.banks.on[:, row]
    assert set(on.tolist()) == {0.0}
    assert not [device for device in after.devices if "c83" in getattr(device, "names", ())]
    everything = " + ".join(f"capacitor {name}" for name in scenario.feeder.network.capacitor.name)
    assert with_outage(before, everything).grid_control.capacitors in ("fixed", ())
