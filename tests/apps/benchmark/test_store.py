"""Units on disk: finished units and refused files."""

import dataclasses
import json
from pathlib import Path

import pytest

from dcgrid_env import __version__
from dcgrid_env.apps.benchmark.jobs import Unit
from dcgrid_env.apps.benchmark.store import Store

UNIT = Unit("toy6", "droop", 0, 25, "scenario", "controller", __version__)


def record(unit):
    return {"unit": dataclasses.asdict(unit), "episodes": [1, 2]}


def test_a_unit_comes_back_if_all_is_the_same(tmp_path):
    store = Store(tmp_path)
    assert store.get(UNIT) is None
    store.put(UNIT, record(UNIT))
    assert Store(tmp_path).get(UNIT) == record(UNIT)
    for other in ({"first": 25}, {"episodes": 20}, {"controller": "none"}, {"scenario": "ieee123"}):
        assert store.get(dataclasses.replace(UNIT, **other)) is None
    assert store.get(dataclasses.replace(UNIT, controller_hash="changed")) is None
    assert not list(tmp_path.rglob("*.part"))


def test_two_benchmarks_in_one_folder_keep_whole_units(tmp_path, monkeypatch):
    one, other, replace = Store(tmp_path), Store(tmp_path), Path.replace

    def meanwhile(self, target):
        monkeypatch.setattr(Path, "replace", replace)
        other.put(UNIT, record(UNIT))
        return replace(self, target)

    one.put(dataclasses.replace(UNIT, first=25), record(UNIT))  # about.json is there
    monkeypatch.setattr(Path, "replace", meanwhile)
    one.put(UNIT, record(UNIT))
    assert Store(tmp_path).get(UNIT) == record(UNIT)
    assert not list(tmp_path.rglob("*.part"))


def test_names_that_differ_in_signs_alone_stay_apart(tmp_path):
    store = Store(tmp_path)
    specs = ["a/b.py:C", "a_b_py_C", "a.b:py_C", "../../x", "droop", "/very" + 40 * "/long" + ".py:C"]
    paths = [store.path(dataclasses.replace(UNIT, controller=spec)) for spec in specs]
    assert len(set(paths)) == len(specs)
    assert all(path.resolve().is_relative_to(store.folder.resolve()) for path in paths)
    assert store.path(UNIT) == tmp_path / "units" / "toy6" / "droop" / "0-24.json"


def test_another_form_of_the_scenario_is_refused(tmp_path):
    store = Store(tmp_path)
    store.put(UNIT, record(UNIT))
    with pytest.raises(ValueError, match=r"is of another toy6, of hash scenario and not other; give another --out"):
        store.get(dataclasses.replace(UNIT, scenario_hash="other"))


def test_another_version_is_refused(tmp_path, monkeypatch):
    Store(tmp_path).put(UNIT, record(UNIT))
    monkeypatch.setattr("dcgrid_env.apps.benchmark.store.__version__", "9.9")
    with pytest.raises(
        ValueError,
        match=r"holds units of version '.*', this is '9\.9'; give another --out, or delete that folder and .*",
    ):
        Store(tmp_path)


def test_the_folder_of_another_command_is_refused(tmp_path):
    (tmp_path / "results.json").write_text("{}")
    with pytest.raises(ValueError, match="holds the results of another command"):
        Store(tmp_path)


@pytest.mark.parametrize("content", ["", "[1]", '{"unit": '])
def test_a_broken_unit_is_named(tmp_path, content):
    store = Store(tmp_path)
    store.put(UNIT, record(UNIT))
    store.path(UNIT).write_text(content)
    with pytest.raises(ValueError, match=r"0-24\.json(: is not JSON| is no) .*; delete it, and it is computed anew"):
        store.get(UNIT)


@pytest.mark.parametrize(
    "damage",
    [
        lambda r: r.update(unit=5),
        lambda r: r.update(unit={}),
        lambda r: r.pop("unit"),
        lambda r: r.pop("episodes"),
        lambda r: r.update(episodes=7),
        lambda r: r["episodes"].pop(),
        lambda r: r["unit"].pop("scenario_hash"),
        lambda r: r.update(voltage=None),
        lambda r: r.pop("sha256"),
        lambda r: r.clear(),
    ],
)
def test_a_damaged_unit_is_named(tmp_path, damage):
    store = Store(tmp_path)
    store.put(UNIT, record(UNIT))
    path = store.path(UNIT)
    content = json.loads(path.read_text())
    damage(content)
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"0-24\.json is damaged .*; delete it, and it is computed anew") as raised:
        store.get(UNIT)
    assert len(str(raised.value).splitlines()) == 1
    path.unlink()
    assert store.get(UNIT) is None


def test_a_record_that_is_not_finite_is_not_written(tmp_path):
    store = Store(tmp_path)
    with pytest.raises(ValueError, match="not JSON compliant"):
        store.put(UNIT, {"J": float("nan")})
    assert not store.path(UNIT).exists()
    store.put(UNIT, record(UNIT))
    assert json.loads(store.path(UNIT).read_text()).keys() == {*record(UNIT), "sha256"}
    assert store.get(UNIT) == record(UNIT)
