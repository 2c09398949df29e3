"""The page of a replay: what it holds, and what it refuses; test_replay_in_browser.py has it drawn."""

import base64
import gzip
import importlib.util
import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.baselines import make_controller, rollout
from dcgrid_env.core.suggestions import from_clone
from dcgrid_env.rendering import replay
from dcgrid_env.rendering.replay_course import agent_figures, packed

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("plotly") is None, reason=f"plotly not installed; {from_clone('replay')}"
)


def episode(scenario="toy6", controller="none", seed=0, **changes):
    s = make_scenario(scenario, split="test", **changes)
    return rollout(s, make_controller(controller), [seed]).series(0)


def held(page):
    """The data that a page carries."""
    (zipped,) = re.findall(r'id="data">([^<]+)<', page.html)
    return json.loads(gzip.decompress(base64.b64decode(zipped)))


def unpacked(figure):
    steps = np.array([np.nan if d is None else d for d in figure["d"]], np.float64)
    known = np.isfinite(steps)
    steps[known] = np.cumsum(steps[known]) / 10.0 ** figure["k"]
    return steps


def test_a_page_holds_the_episodes_to_the_last_decimal_shown(tmp_path):
    runs = {name: episode("ieee33-weak", name, horizon=12) for name in ("none", "droop")}
    page = replay(runs)
    data = held(page)
    assert data["title"] == "ieee33-weak, test split"
    assert [own["name"] for own in data["runs"]] == ["none", "droop"]
    for own, run in zip(data["runs"], runs.values(), strict=True):
        assert own["steps"] == 13
        np.testing.assert_allclose(np.array([unpacked(v) for v in own["v"]]).T, run.v_pu, atol=0.501e-4)
        np.testing.assert_allclose(unpacked(own["j"])[-1], run.metrics()["J"], atol=1e-5)
        site = own["agents"][0]
        assert set(site) == {"p_kw", "p_ref_kw", "q_kvar", "f_mhz", "backlog_kws"}
        np.testing.assert_allclose(unpacked(site["f_mhz"])[1:], run.f_mhz[:, 0], atol=0.501)
        np.testing.assert_allclose(unpacked(site["backlog_kws"]), run.backlog_kws[:, 0], atol=0.501)
    served = unpacked(data["runs"][0]["agents"][0]["p_kw"])  # at the top clock all that is asked for
    np.testing.assert_allclose(served, unpacked(data["runs"][0]["agents"][0]["p_ref_kw"]), atol=0.11)
    assert replay(runs).html == page.html
    assert page.write(tmp_path / "deep" / "replay.html").read_text(encoding="utf-8") == page.html
    assert "src=" not in re.sub(r'id="plotly">[^<]+', "", page.html)  # nothing from elsewhere
    assert page._repr_html_().startswith('<iframe srcdoc="&lt;!DOCTYPE html&gt;')


@pytest.mark.slow
def test_phases_taps_storages_and_trips_are_there():
    run = episode("ieee13-3ph", "droop", horizon=3)
    three = held(replay(run))
    assert set(three["map"]["nodes"]["phase"]) == {0, 1, 2}
    assert len(three["runs"][0]["tap"]) == sum(len(bank["rows"]) for bank in three["map"]["banks"]) == 3
    measured = run.three_phase.equipment.regulators
    off = measured.relay_v - np.array([119.6, 116.3, 120.3])  # published 122 V and the offsets, with a band of 2 V
    np.testing.assert_allclose(np.transpose([unpacked(one) for one in three["runs"][0]["relay"]]), off, atol=0.0051)
    timers = np.transpose([unpacked(one) for one in three["runs"][0]["timer"]])
    np.testing.assert_allclose(timers, measured.out_of_band_s)
    assert timers.max() == 1.0
    day = held(replay(episode("ieee123-3ph-day", "none", horizon=2)))  # its set points are not constant
    assert "relay" not in day["runs"][0]
    run = episode("ieee33-weak-ups", "droop", horizon=3)
    stored, energy_kwh = agent_figures(run)[-1]["stored_pct"], run.scenario.devices[-1].parameters.energy_kwh
    np.testing.assert_allclose(stored, 100.0 * run.stored_kwh[:, -1] / energy_kwh[-1])
    faulty = make_scenario("fault", split="test")
    lost = rollout(faulty, make_controller("none"), range(8))
    for env_index in range(8):
        run = lost.series(env_index)
        away = np.array([own["on_grid_pct"] == 0.0 for own in agent_figures(run)]).T
        assert (run.p_kw_from_reset[away] == 0.0).all()
        assert away.any() == bool((run.fault[:, 0] < faulty.n_agents).any())


def test_a_voltage_that_is_none_is_left_out():
    assert packed(np.array([1.0, np.nan, 1.0002]), 4) == {"k": 4, "d": [10000, None, 2]}


def test_what_cannot_be_replayed_is_refused(monkeypatch):
    run = episode(horizon=3)
    refused: Any = (
        ([], "history is empty"),
        (None, "history is a NoneType; give what Recorder.series returns, one or several"),
        (Path("results/run"), "history is a .*Path; give what Recorder.series returns"),
        ({"a": "b"}, "history 'a' is a str"),
        ([run] * 5, "5 episodes do not fit side by side; replay 4 at most"),
        ([run, episode(horizon=4)], "history 'episode 2' is of another episode"),
        ([episode("ieee123", horizon=2), episode("ieee123", seed=1, horizon=2)], "of another episode"),
    )
    for history, message in refused:
        with pytest.raises(ValueError, match=message):
            replay(history)
    monkeypatch.setattr("dcgrid_env.rendering.replay_page.MOST_VALUES", 20)
    with pytest.raises(ValueError, match=r"1 x 3 steps at 6 nodes are too much for one page; .*horizon=2"):
        replay(run)
    monkeypatch.undo()
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    with pytest.raises(ValueError, match=r"drawn by plotly; install it, in a clone .*\.\[replay\]"):
        replay(run)


@pytest.mark.slow
def test_a_page_of_600_steps_of_123_buses_is_below_6_mb():
    page = replay({name: episode("ieee123", name, horizon=600) for name in ("none", "droop")})
    assert len(page.html) < 3e6
