"""Load profiles of a scenario: loads by hand, the days of the splits, and errors that name the remedy."""

import pickle

import numpy as np
import pytest

from dcgrid_env import (
    DcgridEnv,
    DcgridVectorEnv,
    LoadProfiles,
    ScenarioError,
    TensorEnv,
    forecast,
    make_scenario,
    profile_coverage,
    scenario_hash,
)
from dcgrid_env.traces import ProfileTable

QUIET = {"background": {"load_sigma": 0.0}}


def table(names, values, step_s=900.0):
    return ProfileTable(0.0, step_s, tuple(names), np.array(values, np.float64))


def loads(scenario, seed=0):
    drawn = forecast(scenario, seed)
    return drawn.p_load_kw, drawn.q_load_kvar


def test_balanced_loads_by_hand():
    base = make_scenario("toy6", **QUIET, datacenters={"clock_law": "linear"})
    feeder, names = base.feeder, base.feeder.bus_ids[1:]
    p_kw, q_kvar = np.array(feeder.p_load_kw), np.array(feeder.q_load_kvar)
    shares = np.outer([0.5, 0.75, 1.0], np.linspace(0.5, 1.5, len(names)))
    fields = {"columns": "bus", "days": "all", "start_h": 0.0, "between": "linear"}
    s = base.replace(load_profiles={"file": table(names, shares), **fields}, dt_s=300.0, horizon=3)
    p, q = loads(s)
    at_steps = shares[0] + np.outer([1 / 3, 2 / 3, 1.0], shares[1] - shares[0])
    fixed = feeder.capacitor_kvar * s.background.capacitors
    np.testing.assert_allclose(p[:, 1:], at_steps * p_kw[1:], rtol=1e-12)
    np.testing.assert_allclose(q[:, 1:], at_steps * q_kvar[1:] - fixed[1:], rtol=1e-12)  # the nominal power factor
    held, _ = loads(s.replace(load_profiles={"between": "hold"}))
    np.testing.assert_allclose(held[:, 1:], shares[[0, 0, 1]] * p_kw[1:], rtol=1e-12)

    one = names[int(np.argmax(p_kw[1:]))]
    at = feeder.index(one)
    given = table([one, f"{one}.q"], [[10.0, 4.0], [20.0, 5.0], [-30.0, 6.0]])
    s = s.replace(load_profiles={"file": given, "unit": "kw", "uncovered": "nominal"}, dt_s=900.0, horizon=2)
    p, q = loads(s)
    assert p[:, at].tolist() == [20.0, -30.0]  # a load that feeds in
    assert (q[:, at] + fixed[at]).tolist() == [5.0, 6.0]
    others = np.arange(feeder.n_bus) != at
    np.testing.assert_array_equal(p[:, others], np.tile(p_kw[others], (2, 1)))  # those without a profile
    coverage = profile_coverage(s)
    assert str(coverage).startswith("1 loads follow a profile;")
    assert one not in coverage.without


def test_three_phase_loads_by_hand():
    base = make_scenario("ieee13-3ph", **QUIET)
    feeder = base.feeder
    names = list(dict.fromkeys(feeder.network.phase_load.name))
    rows = np.array([names.index(feeder.network.phase_load.name[row]) for row in feeder.load_legs.row])
    totals = np.bincount(rows, feeder.load_legs.p_kw)
    shares = np.outer([1.0, 0.5, 0.25], np.linspace(0.5, 1.5, len(names)))
    fields = {"days": "all", "start_h": 0.0}
    s = base.replace(load_profiles={"file": table(names, shares), **fields}, dt_s=900.0, horizon=2)
    n = len(rows)
    p, q = loads(s)
    np.testing.assert_allclose(p[:, :n], shares[1:][:, rows] * feeder.load_legs.p_kw, rtol=1e-12)
    np.testing.assert_allclose(q[:, :n], shares[1:][:, rows] * feeder.load_legs.q_kvar, rtol=1e-12)
    assert not p[:, n:].any()
    in_kw = s.replace(load_profiles={"file": table(names, shares * totals), "unit": "kw"})
    for one, other in zip(loads(in_kw), (p, q), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)
    classes = {name: "early" if i % 2 else "late" for i, name in enumerate(names)}
    by_class = s.replace(
        load_profiles={
            "file": table(["early", "late", "unused"], shares[:, :3]),
            "columns": "class",
            "classes": classes,
        }
    )
    column = np.array([0 if i % 2 else 1 for i in range(len(names))])
    np.testing.assert_allclose(loads(by_class)[0][:, :n], shares[1:][:, column[rows]] * feeder.load_legs.p_kw)
    buses = list(dict.fromkeys(feeder.bus_ids[i] for i in feeder.load_legs.bus))
    by_bus = s.replace(
        load_profiles={"file": table(buses, np.tile([[1.0], [0.5], [0.25]], len(buses))), "columns": "bus"}
    )
    np.testing.assert_allclose(loads(by_bus)[0][:, :n], np.outer([0.5, 0.25], feeder.load_legs.p_kw))


def test_noise_scales_the_profile():
    s = make_scenario("ieee33", load_profiles={"file": _days(10), "columns": "class", "classes": _all_home("ieee33")})
    p, q = loads(s)
    quiet_p, quiet_q = loads(s.replace(background={"load_sigma": 0.0}))
    loaded = quiet_p[0] > 0
    factor = p[:, loaded] / quiet_p[:, loaded]
    assert 0.03 < factor.std() < 0.07
    held = s.feeder.capacitor_kvar[loaded] * s.background.capacitors
    np.testing.assert_allclose((q[:, loaded] + held) / (quiet_q[:, loaded] + held), factor)


def _days(n, step_s=900.0):
    return table(["home"], np.linspace(0.4, 1.0, round(n * 86400 / step_s))[:, None], step_s)


def _all_home(name):
    return dict.fromkeys(make_scenario(name).feeder.bus_ids[1:], "home")


def test_no_day_is_in_two_splits_and_starts_fall_into_the_splits_days():
    fields = {"columns": "class", "classes": _all_home("ieee33")}
    year = LoadProfiles(file=_days(365), **fields)
    days = {split: set() for split in ("train", "validation", "test")}
    for split, found in days.items():
        for low, high in year.ranges_h(split):
            found |= set(range(round(low / 24.0), round(high / 24.0)))
    assert {split: len(found) for split, found in days.items()} == {"train": 224, "validation": 71, "test": 70}
    assert set.union(*days.values()) == set(range(365))
    assert year.ranges_h("ood") == year.ranges_h("test")
    from dcgrid_env.engine.exogenous import episode

    for split, found in days.items():
        s = make_scenario("ieee33", load_profiles=year, split=split)
        begin_h = episode.draw(s, np.arange(500, dtype=np.uint64), np.zeros(500, np.uint64)).begin_h
        assert set((begin_h // 24.0).astype(int)) <= found
        assert len(set(begin_h // 24.0)) > 50
        at_nine = s.replace(**{"background.start_hour": 9.0})
        begin_h = episode.draw(at_nine, np.arange(500, dtype=np.uint64), np.zeros(500, np.uint64)).begin_h
        assert set(begin_h % 24.0) == {9.0}
        assert set((begin_h // 24.0).astype(int)) <= found


@pytest.mark.slow
def test_an_episode_may_be_as_long_as_a_day_and_a_short_file_repeats():
    fields = {"columns": "class", "classes": _all_home("ieee33")}
    day = make_scenario("ieee33", load_profiles={"file": _days(5), **fields}, split="test", dt_s=900.0, horizon=96)
    p, _ = loads(day.replace(background={"load_sigma": 0.0}))
    at = int(np.argmax(day.feeder.p_load_kw))
    whole = day.load_profiles.table.values[4 * 96 :, 0] * day.feeder.p_load_kw[at]  # the fifth day is that of test
    np.testing.assert_allclose(p[:, at], [*whole[1:], whole[-1]])  # the last sample holds
    one_day = {"file": _days(1), "days": "repeat", "start_h": 23.5, **fields}
    s = make_scenario("ieee33", load_profiles=one_day, dt_s=900.0, horizon=3, **QUIET)
    values = s.load_profiles.table.values[:, 0] * s.feeder.p_load_kw[at]
    np.testing.assert_allclose(loads(s)[0][:, at], [values[95], values[0], values[1]])


@pytest.mark.parametrize("name", ["ieee33", "ieee13-3ph"])
def test_every_interface_draws_the_same_loads(name):
    names = ("home", "home.q")
    file = ProfileTable(0.0, 60.0, names, np.random.default_rng(0).uniform(0.3, 1.0, (7200, 2)))
    base = make_scenario(name)
    loads_of = base.feeder.bus_ids[1:] if name == "ieee33" else base.feeder.network.phase_load.name
    fields = {"file": file, "columns": "class", "classes": dict.fromkeys(loads_of, "home"), "between": "linear"}
    s = base.replace(load_profiles=fields, horizon=6)
    batch, tensors = DcgridVectorEnv(3, s), TensorEnv(s, like=np.zeros(1))
    seen, _ = batch.reset(seed=[0, 1, 2])
    np.testing.assert_allclose(tensors.reset([0, 1, 2]), seen, atol=1e-6)
    one = DcgridEnv(s)
    np.testing.assert_array_equal(one.reset(seed=1)[0], seen[1])
    for _ in range(3):
        action = np.full_like(batch.action_space.sample(), 0.3)
        seen = batch.step(action)[0]
        np.testing.assert_array_equal(one.step(action[1])[0], seen[1])
        np.testing.assert_allclose(tensors.step(action.astype(np.float64))[0], seen, atol=1e-6)
    batch.close()


def test_the_fingerprint_is_of_the_content(tmp_path):
    base = make_scenario("ieee33")
    fields = {"columns": "class", "classes": _all_home("ieee33")}
    s = base.replace(load_profiles={"file": _days(10), **fields})
    again = base.replace(load_profiles={"file": _days(10), **fields})
    other = base.replace(load_profiles={"file": _days(11), **fields})
    assert scenario_hash(s) == scenario_hash(again) == scenario_hash(pickle.loads(pickle.dumps(s)))
    assert len({scenario_hash(base), scenario_hash(s), scenario_hash(other)}) == 3
    assert s.difference(other) == "load_profiles.file"


def test_a_scenario_file_names_the_profiles(tmp_path):
    (tmp_path / "loads.csv").write_text("time_h,home\n0,1\n1,0.5\n2,0.25\n")
    (tmp_path / "classes.csv").write_text("load,class\n" + "".join(f"{bus},home\n" for bus in _all_home("ieee33")))
    path = tmp_path / "mine.toml"
    path.write_text(
        'base = "ieee33"\n[load_profiles]\nfile = "loads.csv"\ncolumns = "class"\nclasses = "classes.csv"\n'
        'days = "all"\n'
    )
    s = make_scenario(path)
    s.to_toml(tmp_path / "again.toml")
    again = make_scenario(tmp_path / "again.toml")
    assert scenario_hash(again.replace(name="mine")) == scenario_hash(s.replace(name="mine"))
    with pytest.raises(ScenarioError, match=r"load_profiles.file is a ProfileTable .*write_profiles"):
        s.replace(load_profiles={"file": _days(10)}).to_toml()


HOME = {"columns": "class", "classes": {"18": "home"}, "uncovered": "nominal"}


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"unit": "kw"}, r"load_profiles.unit is 'kw'; give load_profiles.file too"),
        ({"file": "nowhere.csv"}, r"load_profiles.file is 'nowhere.csv'; nowhere.csv: there is no such file"),
        ({"file": 3}, r"load_profiles.file is 3; give the path of a CSV or Parquet file"),
        ({"file": _days(10), "columns": "class"}, r"load_profiles.classes is None; give the class of each load"),
        ({"file": _days(10), "classes": {"18": "home"}}, r"leave it out, or give columns = 'class'"),
        ({"file": _days(10), **HOME, "unit": "kw"}, r"load_profiles.unit is 'kw'; give 'pu'"),
        ({"file": _days(10), **HOME, "uncovered": "refuse"}, r"has no profile for 31 loads: 2, 3, 4, 5, 6 and 26 more"),
        ({"file": _days(10), **HOME, "classes": {"99": "home"}}, r"feeder 'ieee33' has no bus '99'"),
        ({"file": _days(10), **HOME, "classes": {"18": "house"}}, r"'18 = house'; load profiles has the columns home"),
        ({"file": _days(10), "columns": "bus"}, r"column 'home'.*feeder 'ieee33' has no bus of this name"),
        ({"file": table(["18.q"], [[1], [1]]), "columns": "bus"}, r"give active power too, in a column '18'"),
        (
            {"file": _days(4), **HOME},
            r"split 'test' at most 0 h at a time.*an episode lasts 0.0333333 h; give a longer",
        ),
        ({"file": _days(0.75), **HOME, "days": "repeat"}, r"give 'all', or a file of whole days: this one covers 18 h"),
        ({"file": _days(10), **HOME, "start_h": 1.0}, r"start_h is 1.0; give a begin of the split 'test' within 96"),
        ({"file": _days(10), **HOME, "start_h": -1.0}, r"start_h is -1.0; give a finite number in \[0, 1e"),
        ({"file": _days(10), **HOME, "between": "cubic"}, r"between is 'cubic'; choose one of hold, linear"),
    ],
)
def test_what_cannot_be_is_refused_by_name(fields, said):
    with pytest.raises(ScenarioError, match=said):
        make_scenario("ieee33", split="test", load_profiles=fields)


def test_what_does_not_fit_the_rest_of_the_scenario():
    with pytest.raises(ScenarioError, match=r"random feeders have other loads in each episode"):
        make_scenario("zero-shot", load_profiles={"file": _days(10), "columns": "bus"})
    both = {"file": _days(10), **HOME, "days": "all", "start_h": 3.0}
    with pytest.raises(
        ScenarioError, match=r"background.start_hour is 2.0; leave it out, or leave load_profiles.start_h"
    ):
        make_scenario("ieee33", load_profiles=both, **{"background.start_hour": 2.0})
    with pytest.raises(ScenarioError, match=r"an episode lasts 300 h; give a longer file"):
        make_scenario("ieee33", load_profiles={"file": _days(10), **HOME, "days": "all"}, dt_s=3600.0, horizon=300)
