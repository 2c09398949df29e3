"""Ten questions of a planner, answered from the report of a request on a small three-phase feeder alone."""

import html
import json
import re

import pytest

from dcgrid_env.cli.main import main

pytestmark = pytest.mark.slow

FILE = """
title = "0.3 MW at bus 671"
feeder = "ieee13-3ph"
bus = "671"
mw = 0.3
outages = ["all"]

[several_sites]
buses = [633]
rule = "sum"

[capacity]
buses = ["633"]
samples = 2
window_s = 12.0
settle_s = 6.0
v_min_pu = 0.9
v_max_pu = 1.1
loading_max_pct = 130.0
max_mw = 2.0
tolerance_mw = 0.05

[limits]
ramp_kw_per_s = 1.0
source = "agreement, clause 7"
"""


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """The report as JSON values, and the text of the page without its pictures."""
    folder = tmp_path_factory.mktemp("study")
    (folder / "study.toml").write_text(FILE)
    main(["study", str(folder / "study.toml"), "--out", str(folder / "out"), "--workers", "2"])
    page = (folder / "out/report.html").read_text()
    text = html.unescape(re.sub(r"<[^>]*>", " ", re.sub(r"<(style|img)[^>]*>([^<]*</style>)?", "", page)))
    return json.loads((folder / "out/report.json").read_text()), " ".join(text.split())


def rows(record, section, title):
    """The rows of the table of a section whose title contains a text."""
    (table,) = [table for table in record["sections"][section]["tables"] if title in table["title"]]
    return {row[0]: row[1:] for row in table["rows"]}


def test_the_report_answers_ten_questions(report):
    record, page = report
    # 1. Does the request fit, and how many MW does the bus carry?
    capacities = {(c["controller"], c["bus"]): c for c in record["capacity"]["capacities"]}
    mw = {name: capacities[name, "671"]["capacity_mw"] for name in ("none", "droop")}
    for name, law in (("none", "Without control"), ("droop", "Under droop")):
        verdict = "fits" if mw[name] >= 0.3 else "does not fit"
        assert f"{law}, 0.3 MW at bus 671 {verdict}: the bus carries {mw[name]:g} MW." in page
    # 2. Which limit binds, where, how near, and at what time?
    assert f"The next size breaks: {capacities['none', '671']['limit']}." in page
    limits = record["sections"]["worst-window"]["tables"][0]
    assert {row[0] for row in limits["rows"]} == {"none", "droop"}
    assert {row[4] for row in limits["rows"]} <= {"11:30", "23:30", "10:15", "03:30"}
    # 3. Under which controllers, and how long does work wait?
    assert rows(record, "inputs", "Assumptions")["controllers"] == ["none, droop"]
    assert [f"{capacities['droop', '671']['delay_mean_s']:.2f}"] == rows(record, "capacity", "under droop")[
        "671 (requested)"
    ][4:5]
    # 4. What remains with an element out of service, and together with another site?
    outages = rows(record, "outages", "with outages")
    assert list(outages) == ["none", "capacitor cap1", "capacitor cap2", "regulator reg1"]
    assert float(outages["none"][0].removeprefix(">=")) == mw["none"]
    worst = min(outages, key=lambda name: float(outages[name][0].removeprefix(">=")))
    assert f"in the worst outage ({worst})" in page
    together = rows(record, "several-sites", "Sites at once, rule sum")
    assert float(together["671"][0]) + float(together["633"][0]) == pytest.approx(float(together["sum"][0]))
    # 5. How many taps more does each regulator make in a day?
    taps = rows(record, "day", "Taps of the regulators in a day")
    assert [int(b) - int(a) for a, b, _ in taps.values()] == [int(more) for _, _, more in taps.values()]
    assert f"the regulators make {taps['all'][1]} instead of {taps['all'][0]} taps a day" in page
    # 6. Do ramps and flicker stay within which limits, from which source?
    assert rows(record, "fluctuation", "Largest values")["limit"] == ["1", "3", "1"]
    assert "Above the limits (agreement, clause 7): the ramp without control, the ramp under droop" in page
    # 7. Which ride-through curve was assumed, and how much load trips?
    assert rows(record, "ride-through", "curve itic")["below 0.7 p.u."] == ["0.02 s"]
    assert "By the curve itic, the sags virginia-2024 disconnect the site 3 times, and 300 kW are lost" in page
    # 8. Which elements and buses were not checked?
    ratings = record["capacity"]["ratings"]
    assert f"{len(ratings['not_checked'])} of {ratings['of']} elements have no known rating" in page
    assert ratings["not_checked"][0] in " ".join(record["sections"]["not-checked"]["text"])
    # 9. What does 1 % of source voltage change?
    changed = rows(record, "sensitivity", "Snapshot capacity")
    less, more = changed["source voltage -1 %"][0], changed["source voltage +1 %"][0]
    assert f"{less} MW with 1 % less source voltage and {more} MW with 1 % more" in page
    # 10. From which files and versions, how sure is it, and what needs other studies?
    assert len(rows(record, "inputs", "Files")["study.toml"][0]) == 64
    assert "dcgrid-env" in rows(record, "inputs", "Assumptions")["versions"][0]
    assert "less than 78 % of other windows do, with 95 % confidence" in record["confidence"]
    assert "protection" in rows(record, "not-checked", "other means")
