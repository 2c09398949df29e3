"""What buses carry, against cases worked by hand and against what must hold of any answer."""

import dataclasses
import math
from dataclasses import replace

import numpy as np
import pytest

from dcgrid_env import Feeder, FeederError, Scenario, ThreePhaseFeeder, load_feeder, make_scenario
from dcgrid_env.apps.hosting.added_site import AddedSite
from dcgrid_env.apps.hosting.capacity_study import Study
from dcgrid_env.apps.hosting.hosting import hosting_capacity
from dcgrid_env.apps.hosting.trial import run_trial
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.core.work.unit import LostUnits
from dcgrid_env.traces import PowerTrace
from helpers.looped import ieee33_with_ties

SHORT = {"samples": 2, "window_s": 10.0, "settle_s": 4.0}
FULL = PowerTrace([0.0, 600.0], [1.0, 1.0], "full load", compute_kw=[1.0, 1.0])
R_OHM, X_OHM, KV, LOAD_KW = 0.8, 0.5, 10.0, 300.0


def on(feeder, **fields):
    sizes = {
        "datacenters.p_rated_kw": 1.0,
        "datacenters.s_rated_share": 1.1,
        "datacenters.q_max_share": 0.33,
        "inverters.buses": (),
        "inverters.s_rated_kva": 0.0,
    }
    return Scenario(name="study", feeder=feeder, n_datacenters=1, split="test", **(sizes | fields))


def two_buses(rating_a=None):
    feeder = Feeder.from_tables(
        name="two", base_kv=KV, substation="a", v0_pu=1.0, bus_ids=["a", "b"], p_load_kw=[0.0, LOAD_KW],
        q_load_kvar=[0.0, 0.0], from_bus=["a"], to_bus=["b"], r_ohm=[R_OHM], x_ohm=[X_OHM], rating_a=rating_a,
    )  # fmt: skip
    return on(feeder, trace=(FULL,), background={"load_sigma": 0.0}, source_voltage_pu=1.0)


def carried(scenario, *controllers, **fields):
    found = hosting_capacity(Study(scenario=scenario, others=False, **(SHORT | fields)), controllers or ("none",))
    return found, [[c.capacity_mw for c in found.by_controller[name]] for name in found.controllers]


def largest_by_voltage(v2):
    """(V2^2 + r P)^2 + (x P)^2 = V0^2 V2^2 at unity power factor, solved for P, MW, and less the load."""
    r, x = R_OHM / KV**2, X_OHM / KV**2
    z_sq, v_sq = r * r + x * x, v2 * v2
    return (math.sqrt(r * r * v_sq * v_sq + z_sq * v_sq * (1.0 - v_sq)) - r * v_sq) / z_sq - LOAD_KW / 1000.0


@pytest.mark.parametrize("v_min", [0.95, 0.97])
def test_two_buses_carry_what_the_voltage_equation_says(v_min):
    found, [[mw]] = carried(two_buses(), load="peak", v_min_pu=v_min, tolerance_mw=0.001, max_mw=10.0)
    assert mw == pytest.approx(largest_by_voltage(v_min), abs=0.001)
    assert mw <= largest_by_voltage(v_min)
    (only,), (snapshot,) = found.by_controller["none"], found.snapshot
    assert only.limit == "undervoltage at bus b"
    assert not only.at_most
    assert snapshot.capacity_mw == mw
    assert (only.delay_mean_s, only.delay_p95_s, only.unserved_pct, only.outside_pct) == (0.0, 0.0, 0.0, 0.0)


def test_two_buses_carry_what_the_rating_of_their_branch_says():
    current_a = 100.0
    drop = current_a * math.sqrt(3.0) / 1000.0  # I in units of 1 MVA / (sqrt(3) kV), over kV
    v2 = math.sqrt(1.0 - (X_OHM / KV * drop) ** 2) - R_OHM / KV * drop
    largest = math.sqrt(3.0) * v2 * KV * current_a / 1000.0 - LOAD_KW / 1000.0
    found, [[mw]] = carried(two_buses([current_a]), load="peak", tolerance_mw=0.001, max_mw=10.0, v_min_pu=0.9)
    assert mw <= largest
    assert mw == pytest.approx(largest, abs=0.0011)
    assert found.by_controller["none"][0].limit == "overload of branch a-b"
    _, [[more]] = carried(
        two_buses([current_a]), load="peak", tolerance_mw=0.001, max_mw=10.0, v_min_pu=0.9, loading_max_pct=120.0
    )
    assert more > 1.15 * mw


def voltage_at(site_mw):
    """The larger root of V2^4 + (2 r P - V0^2) V2^2 + (z P)^2 = 0."""
    r, x, p = R_OHM / KV**2, X_OHM / KV**2, site_mw + LOAD_KW / 1000.0
    half = 0.5 - r * p
    return math.sqrt(half + math.sqrt(half * half - (r * r + x * x) * p * p))


@pytest.mark.parametrize("step_pct", [1.0, 3.0])
def test_a_step_of_the_site_changes_the_voltage_as_the_equation_says(step_pct):
    """Outside of the middle third of the window the trace asks for nothing."""
    idle = PowerTrace([0.0, 99990.0, 100000.0], [0.0, 0.0, 1.0], "idle", compute_kw=[0.0, 0.0, 1.0])
    scenario = two_buses().replace(trace=(idle,), split="train")
    found, [[mw]] = carried(
        scenario, load="peak", tolerance_mw=0.001, max_mw=10.0, v_min_pu=0.5, voltage_step_max_pct=step_pct
    )
    assert found.by_controller["none"][0].limit == "voltage step at bus b"
    steps = [100.0 * (voltage_at(0.0) - voltage_at(size)) for size in (mw, mw + 0.001)]
    assert steps[0] <= step_pct + 1e-6 < steps[1] + 2e-3


def test_losses_limit_by_their_mean_over_the_window():
    limit_kw = 30.0
    found, [[mw]] = carried(
        two_buses(), load="peak", tolerance_mw=0.001, max_mw=10.0, v_min_pu=0.5, loss_max_kw=limit_kw
    )
    assert found.by_controller["none"][0].limit == "loss"
    losses = [1000.0 * R_OHM / KV**2 * ((size + LOAD_KW / 1000.0) / voltage_at(size)) ** 2 for size in (mw, mw + 0.001)]
    assert losses[0] <= limit_kw < losses[1]


@pytest.mark.slow
def test_taps_limit_by_the_regulator_that_makes_the_most():
    scenario = make_scenario("ieee13-3ph", split="test")
    study = Study(
        scenario=scenario, others=False, buses=("671",), samples=2, window_s=300.0, settle_s=60.0,
        taps_max_per_hour=20.0, max_mw=2.0, tolerance_mw=0.05, v_min_pu=0.8, v_max_pu=1.2, loading_max_pct=1000.0,
    )  # fmt: skip
    (free,) = hosting_capacity(dataclasses.replace(study, taps_max_per_hour=None), ["none"]).by_controller["none"]
    (found,) = hosting_capacity(study, ["none"]).by_controller["none"]
    assert found.capacity_mw < free.capacity_mw
    assert found.limit.startswith("taps of regulator reg")


def test_a_limit_of_taps_needs_regulators():
    with pytest.raises(ValueError, match="the feeder has no regulators; give None"):
        Study(scenario=two_buses(), taps_max_per_hour=3.0)


@pytest.mark.slow
def test_windows_alone_carry_at_least_what_all_carry():
    scenario = on(load_feeder("ieee33"), source_voltage_pu=1.05)
    study = Study(scenario=scenario, others=False, buses=("6", "18"), samples=8)
    for found in hosting_capacity(study, ["none"]).by_controller["none"]:
        assert 0.0 < found.capacity_mw <= found.most_windows_mw <= found.half_windows_mw
        assert found.half_windows_mw > 1.1 * found.capacity_mw


CIRCUIT = """
Clear
New Circuit.two basekv=12.47 pu=1 bus1=src MVAsc3=20000 MVAsc1=20000
New Line.first bus1=src bus2=m r1=0.01 x1=0.01 r0=0.01 x0=0.01 c1=0 c0=0 length=1 normamps=%s
New Line.second bus1=m bus2=n r1=0.01 x1=0.01 r0=0.01 x0=0.01 c1=0 c0=0 length=1 normamps=%s
New Transformer.low phases=3 buses=(m p) conns=(delta wye) kvs=(12.47 0.48) kvas=(1000 900) xhl=1 %%r=0.1
New Load.d bus1=n kv=12.47 kw=300 kvar=0
New Load.e bus1=p kv=0.48 kw=100 kvar=0
Set VoltageBases=[12.47 0.48]
CalcVoltageBases
"""


def imported(tmp_path, first, second):
    read_opendss = pytest.importorskip("dcgrid_env.apps.importers.opendss").read_opendss
    path = tmp_path / "two.dss"
    path.write_text(CIRCUIT % (first, second))
    feeder = ThreePhaseFeeder.from_network(read_opendss(path).network)
    return on(feeder, trace=(FULL,), background={"load_sigma": 0.0}, source_voltage_pu=1.0, power_flow="sweep")


@pytest.mark.slow
def test_cables_of_400_a_limit_as_those_of_399_a_do(tmp_path):
    """300 kW and a site at n: sqrt(3) V I of the cables, less the load at p that the first one carries too."""
    wide = {"load": "peak", "tolerance_mw": 0.001, "max_mw": 12.0, "v_min_pu": 0.9, "v_max_pu": 1.1}
    mw = {amps: carried(imported(tmp_path, amps, amps), buses=("n",), **wide)[1][0][0] for amps in (399, 400)}
    for amps, found in mw.items():
        assert found == pytest.approx(math.sqrt(3.0) * 12.47 * amps / 1000.0 - 0.4, rel=2e-3)
    assert mw[400] - mw[399] == pytest.approx(math.sqrt(3.0) * 12.47 / 1000.0, abs=0.002)


@pytest.mark.slow
def test_a_transformer_limits_by_the_kva_of_its_smaller_winding(tmp_path):
    wide = {"load": "peak", "tolerance_mw": 0.001, "max_mw": 3.0, "v_min_pu": 0.9, "v_max_pu": 1.1}
    found, [[mw]] = carried(imported(tmp_path, 600, 600), buses=("p",), **wide)
    assert mw == pytest.approx(0.9 - 0.1, abs=0.006)  # its voltage is half a percent below the rated one
    assert mw < 0.8
    assert found.by_controller["none"][0].limit.startswith("overload of transformer low, phase ")


@pytest.mark.slow
def test_sampled_windows_hold_the_full_rating():
    """Whatever the trace asks for: at peak load, without noise, a window is then as strict as the snapshot."""
    for scenario in (on(load_feeder("ieee33"), source_voltage_pu=1.05), make_scenario("ieee33-weak", split="test")):
        still = scenario.replace(background={"load_sigma": 0.0}, inverters={"buses": (), "s_rated_kva": 0.0})
        several = scenario.datacenters.count > 1
        study = Study(
            scenario=still, others=several, buses=("6", "18"), load="peak", v_min_pu=0.8, v_max_pu=1.1, **SHORT
        )
        found = hosting_capacity(study, ["none"])
        sampled = [c.capacity_mw for c in found.by_controller["none"]]
        assert sampled == [c.capacity_mw for c in found.snapshot]
        assert min(sampled) > 0.0


def test_what_is_overloaded_without_a_site_does_not_count_elsewhere():
    scenario = make_scenario("ieee13-3ph", split="test")  # phase a of xfm1 is at 116 % of 500 kVA in the base case
    wide = {"max_mw": 2.0, "tolerance_mw": 0.1, "v_min_pu": 0.9, "v_max_pu": 1.1}
    study = Study(scenario=scenario, others=False, buses=("634", "675"), **wide, **SHORT)
    found = hosting_capacity(study, ["none"])
    behind, elsewhere = found.by_controller["none"]
    assert found.overloaded == ("transformer xfm1",)
    assert (behind.capacity_mw, behind.limit) == (0.0, "overload of transformer xfm1, phase a without any site")
    assert elsewhere.capacity_mw > 0.0
    assert elsewhere.limit.startswith("overload of transformer sub, phase ")


def test_a_closing_branch_limits_by_its_rating():
    feeder = ieee33_with_ties(1, rating_a=1000.0)
    scenario = on(feeder, trace=(FULL,), background={"load_sigma": 0.0}, source_voltage_pu=1.0)
    wide = {"load": "peak", "max_mw": 5.0, "tolerance_mw": 0.1, "v_min_pu": 0.5, "v_max_pu": 1.5, "buses": ("8",)}
    closing = feeder.n_bus - 1
    limited = replace(feeder, rating_a=np.where(np.arange(feeder.n_branch) == closing, 60.0, 1000.0))
    (free,), (few,) = (carried(scenario.replace(feeder=one), **wide)[1][0] for one in (feeder, limited))
    found, _ = carried(scenario.replace(feeder=limited), **wide)
    assert 0.0 < few < free
    assert found.by_controller["none"][0].limit == f"overload of {feeder.branch_names[closing]}"
    before = replace(feeder, rating_a=np.where(np.arange(feeder.n_branch) == closing, 1.0, 1000.0))
    with pytest.raises(FeederError, match=r"'ieee33' has loops, and its branch \d+-\d+ is overloaded without any site"):
        carried(scenario.replace(feeder=before), **wide)


@pytest.mark.slow
def test_more_is_carried_within_wider_limits():
    scenario = on(load_feeder("ieee33"), source_voltage_pu=1.0)
    by_width = [
        carried(scenario, buses=("5", "18", "22"), v_min_pu=1.0 - width, v_max_pu=1.0 + width)[1][0]
        for width in (0.09, 0.1, 0.12)
    ]
    assert np.all(np.diff(by_width, axis=0) > 0.0)


@pytest.mark.slow
def test_a_droop_carries_more_at_the_ends_and_its_price_is_delay():
    found, [none, droop] = carried(
        on(load_feeder("ieee33"), source_voltage_pu=1.05),
        "none",
        "droop",
        buses=("18", "33"),
        window_s=30.0,
        settle_s=15.0,
    )
    assert np.all(np.array(droop) > np.array(none))
    assert all(c.delay_mean_s > 0.0 for c in found.by_controller["droop"])
    assert all(c.delay_mean_s == 0.0 for c in found.by_controller["none"])


def test_the_next_size_breaks_a_limit_and_the_answer_does_not():
    study = Study(scenario=on(load_feeder("ieee33"), source_voltage_pu=1.05), others=False, buses=("18",), **SHORT)
    all_found = hosting_capacity(study, ["none"])
    (found,), windows = all_found.by_controller["none"], all_found.windows
    site, size, n = AddedSite(study, windows), round(found.capacity_mw / study.step_mw), len(windows)
    bus = np.full(n, study.scenario.feeder.index("18"))
    holds, breaks = (run_trial(site, NoControl(), s, bus, np.arange(n), "none") for s in (size, size + 1))
    assert not holds.outside.any()
    assert holds.margin == found.margin >= 0.0
    assert breaks.outside.any()
    assert breaks.margin < 0.0


def test_an_environment_comes_to_the_same_whatever_stands_beside_it():
    study = Study(scenario=on(load_feeder("ieee33"), source_voltage_pu=1.05), others=False, **SHORT)
    site, controller = AddedSite(study), NoControl()
    many = run_trial(site, controller, 100, np.array([17, 5, 17]), np.array([0, 1, 1]), "none")
    alone = run_trial(site, controller, 100, np.array([17]), np.array([1]), "none")
    for part, own in zip(many, alone, strict=True):
        np.testing.assert_array_equal(part[2:], own)


def test_the_devices_of_a_scenario_stay_where_they_are():
    scenario = make_scenario("ieee33-weak", split="test")
    site = AddedSite(Study(scenario=scenario, **SHORT))
    of_size = site.scenario(50)
    assert of_size.datacenters.count == 4
    assert scenario.datacenters.buses is not None
    assert of_size.inverters.buses == scenario.inverters.buses
    assert of_size.datacenters.parameters.p_rated_kw[-1] == pytest.approx(1000.0 * site.mw(50))
    _, options = site.reset_arguments(np.array([6, 7]), np.array([0, 1]))
    at = [scenario.feeder.index(bus) for bus in (*scenario.datacenters.buses, *scenario.inverters.buses)]
    np.testing.assert_array_equal(np.delete(options["buses"], 3, axis=1), [at, at])
    np.testing.assert_array_equal(options["buses"][:, 3], [6, 7])


def test_sites_that_are_drawn_stand_where_their_sample_says():
    site = AddedSite(Study(scenario=make_scenario("ieee123", split="test"), **SHORT))
    (_, first), (_, again) = (site.reset_arguments(np.array([b, b]), np.array([0, 1])) for b in (4, 9))
    np.testing.assert_array_equal(np.delete(first["buses"], 5, axis=1), np.delete(again["buses"], 5, axis=1))
    assert first["buses"][0, :5].tolist() != first["buses"][1, :5].tolist()


def test_a_feeder_outside_its_limits_without_a_site_carries_none():
    found, [mw] = carried(on(load_feeder("ieee33"), source_voltage_pu=1.0), buses=("2", "18"))
    assert mw == [0.0, 0.0]
    assert {c.limit for c in found.by_controller["none"]} == {"undervoltage at bus 18"}
    assert not any(c.at_most for c in found.by_controller["none"])


def test_a_large_site_by_the_substation_is_as_large_as_was_tried():
    found, [[mw]] = carried(
        on(load_feeder("ieee33"), source_voltage_pu=1.05), buses=("2",), max_mw=1.0, tolerance_mw=0.5
    )
    assert mw == 1.0
    assert found.by_controller["none"][0].at_most
    assert found.by_controller["none"][0].limit == ""


def test_more_is_carried_where_some_seconds_may_break_limits():
    scenario = on(load_feeder("ieee33"), source_voltage_pu=1.05)
    _, [[strict]] = carried(scenario, buses=("18",))
    found, [[loose]] = carried(scenario, buses=("18",), allowed_pct=30.0)
    assert loose > strict
    assert 0.0 < found.by_controller["none"][0].outside_pct <= 30.0


def test_three_phase_feeders_have_candidates_of_three_phases():
    scenario = make_scenario("ieee13-3ph", split="test")
    feeder = scenario.feeder
    candidates = Study(scenario=scenario, others=False, **SHORT).candidates()
    assert all(len(feeder.nodes_at(at, None)) == 3 for at in candidates)
    assert len(candidates) > 2


def test_a_policy_that_cannot_drive_the_scenario_is_refused_by_name():
    study = Study(scenario=make_scenario("ieee13-3ph", split="test"), others=False, **SHORT)
    with pytest.raises(LostUnits, match="'ieee33-weak-analytic' cannot drive"):
        hosting_capacity(study, ["ieee33-weak-analytic"])


def test_a_tuned_law_without_gains_has_its_defaults_and_says_so():
    scenario = on(load_feeder("ieee33"), source_voltage_pu=1.05)
    found, [tuned, plain] = carried(scenario, "droop-tuned", "droop", buses=("18",))
    assert tuned == plain
    (note,) = found.notes
    assert note.startswith("droop-tuned: no gains are known for this feeder and these devices")


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("samples", 0, "give a whole number from 1 to 10,000"),
        ("samples", 1_000_000, "give a whole number from 1 to 10,000"),
        ("samples", 2.5, "give a whole number from 1"),
        ("load", "night", "choose one of day, peak"),
        ("window_s", 1.0, "give at least 2 s"),
        ("window_s", math.nan, "give at least 2 s"),
        ("window_s", 7200.0, "give at most 3600 s"),
        ("settle_s", 10.0, "give 0 to less than the window's 10 s"),
        ("v_min_pu", 0.0, "give a voltage > 0 p.u."),
        ("v_max_pu", 0.9, "give a voltage above the lowest, 0.95 p.u."),
        ("loading_max_pct", 0.0, "give > 0 %"),
        ("allowed_pct", 100.0, "give a share from 0 to less than 100 %"),
        ("tolerance_mw", -1.0, "give a size > 0 MW"),
        ("tolerance_mw", 1e-9, "give fewer than a million sizes"),
        ("max_mw", math.inf, "give a size > 0 MW"),
    ],
)
def test_what_cannot_be_asked_is_refused(field, value, said):
    with pytest.raises(ValueError, match=f"{field} is .*; {said}"):
        Study(scenario=make_scenario("ieee33"), **(SHORT | {field: value}))


@pytest.mark.parametrize(("buses", "said"), [((), "buses is empty"), (("1",), "the substation '1'"), (("99",), "'99'")])
def test_buses_that_cannot_be_candidates_are_refused(buses, said):
    with pytest.raises(ValueError, match=said):
        Study(scenario=make_scenario("ieee33"), buses=buses, **SHORT).candidates()


def test_random_feeders_are_refused():
    with pytest.raises(ValueError, match="is on random feeders, and capacity is a matter of one; write a member"):
        Study(scenario=make_scenario("zero-shot"))
