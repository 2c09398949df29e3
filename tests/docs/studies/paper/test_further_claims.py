"""Verdicts and reasons of the page's further claims go together; captions follow the runs."""

import re

import numpy as np
import pytest

from dcgrid_env import load_feeder
from dcgrid_env.apps.reproduction.study_runs import Law
from dcgrid_env.apps.reproduction.verdict import DOES_NOT, HOLDS, PARTLY
from docs.studies.paper import load_claims, paper_figures, power_axes
from docs.studies.paper.further_parts import stability
from docs.studies.paper.load_figures import all_sites


def axes(ratio, active_j):
    rise = {"rise_pu_per_mvar": 1.0, "none_J": 2.0, "reactive_J": 1.5}
    plain = {"feeder": "ieee123", "r_over_x": 0.5, "rise_pu_per_mw": 0.5, "active_J": 2.0}
    steep = {"feeder": "ieee33-weak", "r_over_x": 1.5, "rise_pu_per_mw": ratio, "active_J": active_j}
    return {"axes": [rise | plain, rise | steep]}


def dips(*taps):
    """Taps in dips of 0.5, 1 and 31 s, and without one."""
    rows = zip((0.0, 0.5, 1.0, 31.0), (0.0, *taps), strict=True)
    return {"dips": [{"dip_s": dip, "taps": moved, "largest_change_pu": 0.01} for dip, moved in rows]}


def models(std, ramp):
    """Of the 405B model; the two of middle size are at 16 and 21, and 28 and 33."""
    rows = (("llama3-405b", std, ramp), ("mixtral-8x22b", 16.0, 28.0), ("deepseek-v3", 21.0, 33.0))
    return {"models": [{"model": name, "std_pct": s, "ramp_pct": r} for name, s, r in rows]}


def ramps(*shares):
    """Share of ramps of 10 to 20 % at each interval, the others of 5 to 10 %."""
    row = {"ramps": 1000, "large": 50}
    return {
        "ramps": [
            row | {"interval_s": t, "shares_pct": {"5 to 10 %": 100.0 - share, "10 to 20 %": share}}
            for t, share in zip((0.11, 1.0), shares, strict=True)
        ]
    }


CASES = [
    (power_axes.active, axes(1.4, 1.0), HOLDS, "and in what the axis alone does"),
    (power_axes.active, axes(1.4, 1.8), PARTLY, "^it is, per unit of power"),
    (power_axes.active, axes(0.9, 1.8), PARTLY, "^not per unit of power"),
    (power_axes.active, axes(0.9, 2.2), DOES_NOT, "^neither"),
    (load_claims.taps, dips(0.0, 0.0, 6.0), HOLDS, "waits 15 or 30 s"),
    (load_claims.taps, dips(0.0, 1.0, 6.0), PARTLY, "within a second"),
    (load_claims.taps, dips(1.0, 1.0, 6.0), DOES_NOT, "even in the shortest dip"),
    (load_claims.larger_models, models(12.0, 20.0), HOLDS, "four recordings behind Fig. 2"),
    (load_claims.larger_models, models(18.0, 30.0), PARTLY, "one of the two only"),
    (load_claims.larger_models, models(25.0, 40.0), DOES_NOT, "not published"),
    (
        load_claims.ramps,
        ramps(60.0, 70.0),
        HOLDS,
        "95 % of all changes from sample to sample are below 5 %; most of the larger",
    ),
    (load_claims.ramps, ramps(60.0, 30.0), PARTLY, "depends on the interval"),
    (load_claims.ramps, ramps(30.0, 30.0), DOES_NOT, "other larger ones are more frequent"),
]


@pytest.mark.parametrize(("claim", "records", "verdict", "reason"), CASES)
def test_the_reason_goes_with_the_verdict(claim, records, verdict, reason):
    found = claim(records)
    assert found["verdict"] == verdict
    assert re.search(reason, found["reason"])


@pytest.mark.slow
def test_captions_follow_the_runs(few, monkeypatch):
    row = {"k_p_mw_per_pu": 1.0, "gain_reactive_pct": 3.0, "gain_active_pct": 2.0}
    monkeypatch.setattr(paper_figures, "gains", lambda _: [row, row | {"k_p_mw_per_pu": 20.0, "gain_active_pct": 9.0}])
    monkeypatch.setattr(paper_figures, "panel_laws", lambda: [Law(k_p_mw_per_pu=0.0)])
    said = paper_figures.captions(few, 0)
    assert list(said) == [1, 2, 3, 4, 5, 6, 7]
    assert "3.0 % through the data centres' reactive power and by 2.00 % through the clock (k_p = 1)." in said[5]
    assert said[7].endswith("p.u. at least and no work waits.")
    monkeypatch.undo()
    said = paper_figures.captions(few, 0)
    assert "too little to be seen" in said[5]


@pytest.mark.slow
def test_what_waits_at_bus_13_is_that_of_the_runs(few, monkeypatch):
    law = Law(k_p_mw_per_pu=20.0)
    low = all_sites(few).replace(source_voltage_pu=1.0)
    monkeypatch.setattr(paper_figures, "panel_laws", lambda: [law])
    monkeypatch.setattr(paper_figures, "all_sites", lambda _: low)
    series = few.series(low, law, 0)
    most_kws = series.backlog_kws[:, 0].max()
    assert most_kws > 100.0
    said = paper_figures.captions(few, 0)[7]
    lowest_pu = series.v_pu[:, low.feeder.index(13)].min()
    assert said.endswith(f"V is {lowest_pu:.3f} p.u. at least and up to {most_kws:.0f} kW s of work wait.")


def test_turned_keeps_the_impedance():
    feeder = load_feeder("ieee123")
    steep = power_axes.turned(feeder, 3.0)
    np.testing.assert_allclose(np.hypot(steep.r_ohm, steep.x_ohm), np.hypot(feeder.r_ohm, feeder.x_ohm), rtol=1e-12)
    np.testing.assert_allclose(steep.r_ohm * feeder.x_ohm, 3.0 * feeder.r_ohm * steep.x_ohm, rtol=1e-12)


@pytest.mark.slow
def test_active_power_is_stronger_where_r_over_x_is_above_one(few):
    for r in power_axes.axes(few):
        assert (r["rise_pu_per_mw"] > r["rise_pu_per_mvar"]) == (r["r_over_x"] > 1.0)
        assert r["converged_pct"] == 100.0
        assert all(np.isfinite(v) for v in r.values() if not isinstance(v, str))


def test_stability_is_that_of_the_bound(few):
    radius = {(r["n_datacenters"], r["k_p_mw_per_pu"]): r["spectral_radius"] for r in stability(few)}
    assert radius[5, 1.0] <= 1.0 < radius[5, 20.0]
