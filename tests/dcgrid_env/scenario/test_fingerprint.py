"""Hashes: the same for the same, another for anything that differs, in another process too."""

import dataclasses
import subprocess
import sys
from operator import attrgetter
from typing import Any

import numpy as np
import pytest

from dcgrid_env import (
    CostWeights,
    Fault,
    Feeder,
    PrefillDecodeDvfs,
    Scenario,
    Sensing,
    Storages,
    episode_hash,
    make_scenario,
    scenario_hash,
)
from dcgrid_env.core.digest import digest
from dcgrid_env.scenario import fingerprint
from dcgrid_env.scenario.assembly import ALIASES, FORMER, PARTS
from dcgrid_env.scenario.fingerprint import fields
from dcgrid_env.traces import PowerTrace, ProfileTable, Provenance

RIDE_THROUGH_TEST = "80a30c8f07f0d5af"
CHANGES = {
    "horizon": 119,
    "split": "validation",
    "weights": CostWeights(backlog=0.31),
    "datacenters.clock_law": PrefillDecodeDvfs(),
    "faults": (Fault(("inverter",), (1.0, 2.0)),),
    "trace": (PowerTrace([0.0, 500.0, 1000.0], [1.0, 0.5, 0.5], "own"),),
    "feeder": "ieee123",
    "inverters.s_rated_kva": 51.0,
    "datacenters.buses": (1, 3, 4, 5, 6),
    "sensing.preview": False,
    "cost.ramp_limit_kw_per_s": 100.0,
}


def test_every_change_shows():
    hashes = {scenario_hash(make_scenario("ieee123", split="test"))}
    for name, value in CHANGES.items():
        if name != "feeder":
            hashes.add(scenario_hash(make_scenario("ieee123", split="test").replace(**{name: value})))
    assert len(hashes) == len(CHANGES)
    assert all(len(h) == 16 and int(h, 16) >= 0 for h in hashes)
    moved = make_scenario("ieee33").feeder
    assert scenario_hash(make_scenario("ieee33-weak")) != scenario_hash(make_scenario("ieee33-weak", name="other"))
    assert scenario_hash(make_scenario("ieee33-weak")) == scenario_hash(make_scenario("ieee33-weak", feeder=moved))


def test_a_law_of_ones_own_shows_by_its_figures():
    class Law:
        work_classes = 1

        def __init__(self, slope):
            self.slope = slope

        def serve(self, params, f_mhz, work_kw):
            return work_kw, work_kw

    one, two, again = (
        scenario_hash(make_scenario("toy6", datacenters={"clock_law": Law(slope)})) for slope in (1.0, 2.0, 1.0)
    )
    assert one == again != two


def test_a_law_whose_figures_cannot_be_read_is_named():
    class Slotted:
        __slots__ = ("slope",)
        work_classes = 1

        def serve(self, params, f_mhz, work_kw):
            return work_kw, work_kw

    with pytest.raises(ValueError, match=r"Slotted has __slots__.*give it a __dict__ or make it a dataclass"):
        scenario_hash(make_scenario("toy6", datacenters={"clock_law": Slotted()}))


def test_an_episode_is_known_by_what_comes_from_outside():
    scenario = make_scenario("ieee33-weak", split="test")
    first = episode_hash(scenario, 0)
    assert first == episode_hash(make_scenario("ieee33-weak", split="test"), 0)
    assert first != episode_hash(scenario, 1)
    assert first != episode_hash(scenario.replace(split="train"), 0)
    # What the controllers are told changes nothing of what comes from outside.
    assert first == episode_hash(scenario.replace(sensing={"noise_pu": 0.01, "preview": False}, observe="feeder"), 0)


def renamed(scenario, name):
    """The same scenario on the same feeder under other bus ids."""
    feeder = dataclasses.replace(scenario.feeder, bus_ids=tuple(map(name, scenario.feeder.bus_ids)))
    placed = {
        group: {"buses": tuple(map(name, getattr(scenario, group).buses))} for group in ("datacenters", "inverters")
    }
    return scenario.replace(feeder=feeder, **placed)


def test_buses_that_are_whole_numbers_are_hashed_as_numbers():
    scenario = make_scenario("ieee33-weak")
    assert dict(fields(scenario.feeder)[1])["bus_ids"] == tuple(range(1, 34))  # pyright: ignore[reportOptionalSubscript]
    always = dict(fields(scenario)[1])  # pyright: ignore[reportOptionalSubscript]
    assert (always["datacenter_buses"], always["inverter_buses"]) == ((18, 33, 25), (7, 14, 20, 30))
    assert dict(fields(make_scenario("ieee123"))[1])["datacenter_buses"] is None  # pyright: ignore
    assert scenario_hash(scenario.replace(datacenters={"buses": ("18", "33", "25")})) == scenario_hash(scenario)


def test_buses_of_which_one_is_no_whole_number_are_hashed_as_text():
    scenario = renamed(make_scenario("ieee33-weak"), lambda bus: "12a" if bus == "12" else bus)
    always = dict(fields(scenario)[1])  # pyright: ignore[reportOptionalSubscript]
    assert always["datacenter_buses"] == ("18", "33", "25")
    assert scenario_hash(scenario) != scenario_hash(make_scenario("ieee33-weak"))


@pytest.mark.slow
def test_hashes_are_the_same_in_another_process():
    code = (
        "from dcgrid_env import episode_hash, make_scenario, scenario_hash; s = make_scenario('fault', split='test');"
        "print(scenario_hash(s), episode_hash(s, 3))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    scenario = make_scenario("fault", split="test")
    assert done.stdout.split() == [scenario_hash(scenario), episode_hash(scenario, 3)]


@dataclasses.dataclass(frozen=True, eq=False)
class _LaterFeeder(Feeder):
    """A feeder with a field that came after hashes were published."""

    frequency_hz: float = 50.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class _LaterSensing(Sensing):
    """A part with a field that came later."""

    lost_share: float = 0.0


def test_a_later_field_at_its_default_changes_no_hash(monkeypatch):
    monkeypatch.setitem(fingerprint.SCHEMA_1, _LaterFeeder, fingerprint.SCHEMA_1[Feeder])
    monkeypatch.setitem(fingerprint._NAMES, _LaterFeeder, "Feeder")
    for name in ("ieee33-weak", "fault"):
        scenario = make_scenario(name, split="test")
        own = {field.name: getattr(scenario.feeder, field.name) for field in dataclasses.fields(Feeder)}
        known = {field.name: getattr(scenario.sensing, field.name) for field in dataclasses.fields(Sensing)}
        later = scenario.replace(feeder=_LaterFeeder(**own), sensing=_LaterSensing(**known))
        assert scenario_hash(later) == scenario_hash(scenario)
        for other in (
            scenario.replace(feeder=_LaterFeeder(**own, frequency_hz=60.0)),
            scenario.replace(sensing=_LaterSensing(**known, lost_share=0.1)),
        ):
            assert scenario_hash(other) != scenario_hash(scenario)


@pytest.mark.parametrize("kind", [kind for kind in fingerprint.SCHEMA_1 if dataclasses.is_dataclass(kind)])
def test_a_field_that_the_schema_does_not_list_has_a_default(kind):
    listed = {name.removesuffix("?") for name in fingerprint.SCHEMA_1[kind].split()}
    if kind is Scenario:
        listed = {(ALIASES | FORMER).get(name, name) for name in listed} | {*PARTS, "devices"}
        for path in listed:
            attrgetter(path)(make_scenario("ieee33"))
    else:
        assert listed <= set(kind.__dataclass_fields__)
    later = [field for field in dataclasses.fields(kind) if field.name not in listed]
    assert all({field.default, field.default_factory} != {dataclasses.MISSING} for field in later)


def test_a_rule_of_ride_through_keeps_its_hash_when_fields_are_added():
    """The schema lists the rules' fields, so that a later one is left out at its default."""
    scenario = make_scenario("ride-through")
    for rule in (scenario.datacenters.ride_through, scenario.inverters.ride_through, scenario.sags[0]):
        assert rule
        assert set(fingerprint.SCHEMA_1[type(rule)].split()) == {field.name for field in dataclasses.fields(rule)}
        assert fields(rule) is not None
    assert scenario_hash(scenario) != scenario_hash(make_scenario("ride-through", sags=scenario.sags[:1]))
    assert scenario_hash(make_scenario("ride-through", split="test")) == RIDE_THROUGH_TEST


@dataclasses.dataclass(frozen=True, kw_only=True)
class _LaterStorages(Storages):
    """Storages with a field that came after a preset of theirs was published."""

    ramp_kw_per_s: float | None = None


def test_a_later_field_of_storages_at_its_default_changes_no_hash(monkeypatch):
    assert set(fingerprint.SCHEMA_1[Storages].split()) == {field.name for field in dataclasses.fields(Storages)}
    monkeypatch.setitem(fingerprint.SCHEMA_1, _LaterStorages, fingerprint.SCHEMA_1[Storages])
    monkeypatch.setitem(fingerprint._NAMES, _LaterStorages, "Storages")
    scenario = make_scenario("ieee33-weak-ups", split="test")
    *others, _ = scenario.devices
    storages: Any = scenario.group("storage")
    given = {field.name: getattr(storages, field.name) for field in dataclasses.fields(storages)}
    assert scenario_hash(scenario.replace(devices=(*others, _LaterStorages(**given)))) == scenario_hash(scenario)
    other = scenario.replace(devices=(*others, _LaterStorages(**given, ramp_kw_per_s=10.0)))
    assert scenario_hash(other) != scenario_hash(scenario)


def test_load_profiles_without_utc_offsets_and_summer_time_have_the_hash_of_tables_without_these_fields():
    table = ProfileTable(0.0, 900.0, ("a",), np.array([[1.0], [2.0]]), "2026-03-01")
    later = ("utc_offset_h", "clock_changes")
    five = [field for field in dataclasses.fields(ProfileTable) if field.name not in later]
    before = dataclasses.make_dataclass("ProfileTable", [field.name for field in five])
    published = digest([("", before(*(getattr(table, field.name) for field in five)))])
    assert digest([("", table)], fields) == published
    for changed in ({"utc_offset_h": 1.0}, {"clock_changes": ((2.0, 1.0),)}):
        assert digest([("", dataclasses.replace(table, **changed))], fields) != published


def test_a_recording_whose_origin_has_lists_has_a_hash():
    traces = [
        PowerTrace([0.0, 500.0, 1000.0], [1.0, 0.5, 0.5], "log", Provenance("log", None, {"columns": columns}))
        for columns in (["site_kw"], ["node_kw"])
    ]
    assert len({scenario_hash(make_scenario("ieee123", trace=(trace,))) for trace in traces}) == 2
