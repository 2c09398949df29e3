"""The study on the balanced equivalent and on the feeder with its phases, side by side."""

import itertools
import json
import re

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.apps.reproduction import bus13, levers
from dcgrid_env.apps.reproduction.load import choose_load
from dcgrid_env.apps.reproduction.study_runs import NO_CONTROL, Runs, Setting, nodes_of
from dcgrid_env.baselines import NoControl, rollout
from docs.studies.paper.feeder_cases import cases, common_sites, setting_of, without_line_regulators
from docs.studies.paper.feeder_comparison import LEFT_OUT, PARTS, compare_feeders
from docs.studies.paper.feeder_comparison_markdown import causes_table, render_comparison
from docs.studies.paper.further_parts import ALL_PARTS

SHORT = Setting(choose_load("generated"), episodes=2, fields={"horizon": 12})


@pytest.fixture(scope="module")
def true():
    return Runs(setting_of(cases()["acting"], SHORT))


@pytest.fixture(scope="module")
def records():
    begun = []
    found = compare_feeders(SHORT, begun.append)
    assert len(begun) == len(PARTS) * len(found["cases"])
    return found


def test_each_form_adds_one_thing_to_the_one_before():
    made = {name: setting_of(case, SHORT).scenario(5) for name, case in cases().items()}
    assert made["balanced"].difference(make_scenario("ieee123", horizon=12, split="test", trace="inference")) is None
    assert made["phases"].difference(made["fixed"]) == "feeder"
    assert made["fixed"].difference(made["acting"]) == "grid_control.regulators"
    assert made["acting"].feeder is make_scenario("ieee123-3ph-published").feeder
    table = without_line_regulators().network.regulator
    moved = {bank for bank, tap in zip(table.bank, table.tap, strict=True) if tap}
    assert moved == {"reg1a"}


def test_sites_that_are_not_drawn_have_three_phases():
    feeder = make_scenario("ieee123-3ph-published").feeder
    assert common_sites() == (13, 28, 53, 77, 99)
    assert {feeder.bus_phases[feeder.index(bus)] for bus in common_sites()} == {"abc"}
    published = Setting(choose_load("generated"), episodes=2, placement="published")
    for case in cases().values():
        setting = setting_of(case, published)
        assert setting.counts == (1, 2, 3, 4, 5)
        assert setting.scenario(2).datacenters.buses == ("13", "28")


def test_settled_on_three_phases_is_the_first_voltage_of_the_environment_without_noise(true):
    scenario = true.setting.pinned((13,), background={"load_sigma": 0.0}, grid_control={"regulators": "fixed"})
    start = rollout(scenario, NoControl(), [0]).series(0)
    drawn = {13: float(start.p_kw[0, 0])}
    # The load of a data centre moves; the base load is still.
    np.testing.assert_allclose(levers.settled(scenario, drawn), start.v_pu[1], atol=1e-6)


@pytest.mark.slow
def test_levers_on_three_phases_by_small_changes(true):
    for record in levers.inverters(true):
        # An inverter on one phase, behind a raised tap, may move the mean of a site's phases more than the site itself.
        assert record["far_x_pu_per_mvar"] < 0.5 * record["near_x_pu_per_mvar"] < 0.6 * record["own_x_pu_per_mvar"]
        assert record["own_rise_pu_per_mvar"] == pytest.approx(record["own_x_pu_per_mvar"], rel=0.1)
    found = bus13.bus_thirteen(true)
    five = true.setting.published(5)
    full = dict.fromkeys(common_sites(), 280.0)
    at = nodes_of(five, 13)
    whole = found["base_pu"] - found["drop_own_pu"] - found["drop_neighbours_pu"]
    assert levers.settled(five, full)[at].mean() == pytest.approx(whole, abs=1e-12)
    edge = found["leaves_band_kw"]
    lowest = [levers.settled(five, full | {13: kw})[at].min() for kw in (edge, edge - 2.0)]
    assert lowest[0] < 0.95 < lowest[1]
    assert found["base_at_1pu"] < found["base_pu"]


def test_a_load_without_a_solution_is_no_voltage(true):
    assert np.isnan(levers.settled(true.setting.published(5), {13: 1e6})).all()


@pytest.mark.slow
def test_records_are_whole_and_the_same_for_each_form(records):
    forms = records["cases"]
    assert list(forms) == ["balanced", "phases", "fixed", "acting"]
    claims = [[row["claim"] for row in form["claims"]] for form in forms.values()]
    assert len(claims[0]) == 13
    assert all(own == claims[0] for own in claims)
    assert not set(LEFT_OUT) & set(claims[0])
    assert len(claims[0]) + len(LEFT_OUT) == 19
    assert set(PARTS) < set(ALL_PARTS)
    assert not re.search("NaN|Infinity", json.dumps(records))
    assert [(o["case"], o["rows"], o["by"]) for o in records["orders"]] == list(
        itertools.product(("phases", "fixed", "acting"), ("table_one", "laws"), ("deviation", "J"))
    )
    assert {o["pairs"] for o in records["orders"]} == {15 * 14 // 2, 5 * 10}
    taps = {(row["case"], row["law"]): row["tap_moves"] for row in records["equipment"]}
    assert {taps[case, "both"] for case in ("phases", "fixed")} == {0.0}
    assert "balanced" not in {case for case, _ in taps}


@pytest.mark.slow
def test_figures_of_the_causes_are_those_of_the_runs(records, true):
    rows = {row["figure"]: row["values"] for row in records["causes"]}
    of_runs = [true.run(true.setting.scenario(n), NO_CONTROL).deviation_pu for n in range(1, 6)]
    assert rows["deviation, no control (p.u.)"]["acting"] == pytest.approx(np.mean(of_runs))
    for row, cells in zip(records["causes"], causes_table(records)[1], strict=True):
        steps = [float(cell) for cell in cells[1:]]
        assert sum(steps[:-1]) == pytest.approx(steps[-1], abs=3 * 10.0 ** -len(cells[1].partition(".")[2])), row


def test_the_document_holds_what_the_records_say(records):
    text = render_comparison(records | {"meta": {"command": "python -m docs.studies reproduction-3ph"}})
    assert "    python -m docs.studies reproduction-3ph\n" in text
    for form in records["cases"].values():
        assert form["about"] in text
        for row in form["table_one"]:
            if row["memory"] == "cumulative":
                assert f"{row['deviation_mean_pu']:.4f} (" in text
    for order in records["orders"]:
        assert f"| {len(order['swapped'])} of {order['pairs']} |" in text
    for claim in (*LEFT_OUT, *(row["claim"] for row in records["cases"]["acting"]["claims"])):
        assert claim in " ".join(text.split())
    assert all(len(line) <= 120 for line in text.splitlines() if not line.startswith("|"))
