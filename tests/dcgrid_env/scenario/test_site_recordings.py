"""The power of recordings at the sites: scaled to their ratings, or as recorded; and what is said of it."""

import json

import numpy as np
import pytest

from dcgrid_env import ScenarioError, make_scenario, scenario_hash
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.cli.main import main
from dcgrid_env.engine.exogenous import episode
from dcgrid_env.scenario.site_recordings import scaled_recordings, scaling_lines
from dcgrid_env.traces import PowerTrace

SECONDS = np.arange(0.0, 401.0)
KW = 300.0 + 100.0 * np.sin(0.3 * SECONDS)
KW[200] = 450.0


def recording(rated_kw=None):
    return PowerTrace(SECONDS, KW, "hall", rated_kw=rated_kw)


def asked(scenario):
    drawn = episode.draw(scenario, np.zeros(1, np.uint64), np.zeros(1, np.uint64))
    return np.array([episode.p_ref_kw(scenario, drawn, np.full(1, k))[0, 0] for k in range(scenario.horizon)])


@pytest.mark.parametrize(("rated_kw", "full_kw"), [(None, 450.0), (600.0, 600.0)])
def test_power_is_scaled_to_the_rating_unless_it_is_to_stay_as_recorded(rated_kw, full_kw):
    trace = recording(rated_kw)
    scaled = make_scenario(
        "toy6", trace=trace, datacenters={"p_rated_kw": 900.0}, workload={"window": "start"}, horizon=100
    )
    kept = scaled.replace(workload={"trace_scale": "as-recorded"})
    np.testing.assert_allclose(asked(kept), trace.resample(1.0)[:100], rtol=1e-12)
    np.testing.assert_allclose(asked(scaled), trace.resample(1.0)[:100] * 900.0 / full_kw, rtol=1e-12)
    (of_scaled,), (of_kept,) = scaled_recordings(scaled), scaled_recordings(kept)
    assert of_scaled == ("hall", full_kw, rated_kw is not None, pytest.approx((900.0 / full_kw,)))
    assert of_kept.factors == (1.0,)
    what = "rating" if rated_kw else "highest power"
    (line,) = scaling_lines(scaled)
    assert line.startswith(f"trace hall: its {what} of {full_kw:g} kW becomes the sites' rating of 900 kW (times ")
    assert scaling_lines(kept) == [f"trace hall: as recorded ({what} {full_kw:g} kW) at sites of 900 kW"]


def test_sites_of_different_ratings_follow_the_same_kilowatts():
    scenario = make_scenario(
        "ieee33-weak",
        trace=recording(),
        datacenters={"p_rated_kw": (500.0, 900.0, 1000.0), "idle_share": 0.2},
        workload={"trace_scale": "as-recorded", "window": "start"},
        horizon=50,
    )
    course = rollout(scenario, NoControl(), [0]).series(0)
    np.testing.assert_allclose(course.p_kw[:, :3], recording().resample(1.0)[1:51, None] * np.ones(3), rtol=1e-9)


def test_the_default_changes_no_fingerprint():
    plain = make_scenario("toy6", trace=recording())
    assert scenario_hash(plain.replace(workload={"trace_scale": "rated"})) == scenario_hash(plain)
    kept = plain.replace(workload={"trace_scale": "as-recorded"}, datacenters={"p_rated_kw": 900.0})
    assert scenario_hash(kept) != scenario_hash(plain.replace(datacenters={"p_rated_kw": 900.0}))


@pytest.mark.parametrize(("changes", "said"), [
    ({"trace": "inference"}, "workload.trace_scale is 'as-recorded'; the trace 'inference' is generated, in shares"),
    ({"trace": recording(1.0)}, "trace 'hall' is in shares of a rating; give its rating .with_site_rating."),
    ({"datacenters.p_rated_kw": 400.0}, "trace 'hall' rises to 450 kW, above the rating of a site, 400 kW; raise"),
    ({"workload.trace_scale": "kW"}, "workload.trace_scale is 'kW'; choose one of rated, as-recorded"),
])  # fmt: skip
def test_what_cannot_be_as_recorded_is_refused(changes, said):
    with pytest.raises(ScenarioError, match=said):
        make_scenario(
            "toy6",
            **(
                {"trace": recording(), "workload.trace_scale": "as-recorded", "datacenters.p_rated_kw": 900.0} | changes
            ),
        )


def test_a_run_prints_and_stores_the_factor(tmp_path, capsys):
    rows = "".join(f"{t:g},{kw:.6f}\n" for t, kw in zip(SECONDS, KW, strict=True))
    (tmp_path / "hall.csv").write_text("time_s,power_kw\n" + rows)
    main(["run", "--scenario", "toy6", "--trace", str(tmp_path / "hall.csv"), "--controllers", "none", "--episodes",
          "1", "--horizon", "20", "--out", str(tmp_path / "out")])  # fmt: skip
    printed = " ".join(capsys.readouterr().out.split())
    assert "its highest power of 450 kW becomes the sites' rating of " in printed
    (stored,) = json.loads((tmp_path / "out/results.json").read_text())["meta"]["trace_scale"]
    assert stored["full_kw"] == 450.0
    assert stored["factors"] == [make_scenario("toy6").site_rated_kw[0] / 450.0]
