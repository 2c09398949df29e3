"""Table I and what it is compared with."""

import math
import re

import pytest

from dcgrid_env.apps.reproduction import table1
from dcgrid_env.apps.reproduction.load import choose_load
from dcgrid_env.apps.reproduction.paper import COUNTS, K_P_MW_PER_PU
from dcgrid_env.apps.reproduction.study_runs import Runs, Setting
from dcgrid_env.baselines import make_controller, rollout
from helpers.places import GPU_RECORDING, ROOT, needs_gpu_recording


@pytest.mark.slow
def test_table_one_and_the_split_of_its_gain(few):
    records = table1.table_one(few)
    cells = {(r["n_datacenters"], r["k_p_mw_per_pu"], r["memory"]): r for r in records}
    forms = ("cumulative", "one_step")
    assert list(cells) == [(n, k_p, m) for n in COUNTS for k_p in K_P_MW_PER_PU for m in forms]
    for record in records:
        assert all(math.isfinite(v) for v in record.values() if not isinstance(v, str))
        assert 0.0 <= record["unserved_pct"] <= 100.0
    for n in COUNTS:
        for memory in forms:
            delays = [cells[n, k_p, memory]["delay_mean_s"] for k_p in K_P_MW_PER_PU]
            assert delays[0] < delays[1] < delays[2]
        # The printed form forgets what waits.
        assert cells[n, 20.0, "one_step"]["unserved_kws"] > cells[n, 20.0, "cumulative"]["unserved_kws"]
    for r in table1.gains(few):
        cell = cells[r["n_datacenters"], r["k_p_mw_per_pu"], "cumulative"]
        gain = 100.0 * (1.0 - cell["deviation_mean_pu"] / r["inverters_pu"])
        assert r["gain_reactive_pct"] + r["gain_active_pct"] == pytest.approx(gain)
        assert r["J"] == cell["J"]


def test_the_cells_are_those_of_a_run(few):
    scenario = few.setting.scenario(5)
    for law, name in (("none", "none"), ("inverters", "inverters"), ("reactive", "droop-q"), ("both", "droop")):
        ours = table1.figures(few.run(scenario, table1.LAWS[law]))
        found = rollout(scenario, make_controller(name), range(3)).metrics()
        mean = sum(m["voltage_deviation_mean_pu"] for m in found) / 3
        assert ours["J"] == pytest.approx(sum(m["J"] for m in found) / 3)
        assert ours["deviation_mean_pu"] == pytest.approx(mean)
        # V^2 - 1 = (V - 1)(V + 1), and V is near 1.
        assert ours["squared_deviation_mean_pu"] == pytest.approx(2.0 * mean, rel=0.03)


@needs_gpu_recording
def test_the_document_holds_what_the_runs_give():
    text = (ROOT / "docs" / "reproduction.md").read_text(encoding="utf-8")
    unwrapped = " ".join(text.split())
    episodes = re.search(r"(\d+) episodes of 120 s", unwrapped)
    assert episodes is not None
    assert "Load: **recorded**" in unwrapped
    runs = Runs(Setting(choose_load(str(GPU_RECORDING)), int(episodes[1])))
    for law, label in (("none", "no control"), ("inverters", "inverters only"), ("both", "both axes")):
        line = re.search(rf"^\| 5 \| {label} \| (.*) \|$", text, re.MULTILINE)
        assert line is not None
        found = table1.figures(runs.run(runs.setting.scenario(5), table1.LAWS[law]))
        columns = {"deviation_mean_pu": 4, "deviation_std_pu": 4, "squared_deviation_mean_pu": 4}
        columns |= {"buses_inside_pct": 1, "voltage_min_pu": 3, "delay_mean_s": 2, "J": 3}
        for cell, (key, decimals) in zip(line[1].split(" | "), columns.items(), strict=True):
            # Half a digit, and a little for the last bits of another processor's sums.
            assert float(cell) == pytest.approx(found[key], abs=0.51 * 10.0**-decimals), key
