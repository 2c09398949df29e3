"""Folders of three-phase feeders: reading, and refusals by file, line and column."""

from dataclasses import replace

import pytest

from dcgrid_env import FeederError, ThreePhaseFeeder, load_feeder


@pytest.fixture
def folder(tmp_path):
    load_feeder("ieee13-3ph").to_csv(tmp_path)
    return tmp_path


def change(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize(("file", "old", "new", "message"), [
    ("loads.csv", "leg_kv", "leg_kV", r"loads\.csv: the column 'leg_kv' is missing"),
    ("lines.csv", "length_m", "length", r"lines\.csv: the column 'length' is unknown; the columns are name"),
    ("capacitors.csv", "state", "state,state", r"capacitors\.csv: the column 'state' is there twice"),
    ("buses.csv", "phases", "phase", r"buses\.csv: the column 'phases' is missing"),
    ("buses.csv", "645,bc", "645,cb", r"buses\.csv, line \d+: phases is 'cb'; give letters in order"),
    ("buses.csv", "645,bc", "632,bc", r"buses\.csv, line \d+: bus is '632'; give each bus one row"),
    ("transformers.csv", "5000.0", "big", r"transformers\.csv, line 2: kva is 'big'; give a number"),
    ("transformers.csv", "5000.0", "inf", r"transformers\.csv, line 2: kva is 'inf'; give a finite number"),
    ("transformers.csv", "5000.0", "", r"transformers\.csv, line 2: kva is ''; give a number"),
    ("switches.csv", "closed", "", r"switches\.csv, line 2: state is empty"),
    ("switches.csv", "closed,1e-07,0.0", "closed,1e-07,0.0,5", r"switches\.csv, line 2: .* beyond the last column"),
    ("regulators.csv", ",10,0,", ",10.5,0,", r"regulator reg1: tap is 10\.5; give a whole number"),
    ("feeder.toml", "frequency_hz", "frequency", r"feeder\.toml: the key 'frequency' is not known; choose name, freq"),
    ("feeder.toml", "v_pu", "v0_pu", r"feeder\.toml: the key 'v_pu' is missing"),
    ("feeder.toml", "[source]", "[sauce]", r"feeder\.toml: the table \[source\] is missing"),
    ("feeder.toml", "[source]", "source", r"feeder\.toml: "),
    ("feeder.toml", '"sourcebus"', "3", r"feeder\.toml: bus is 3; give a text"),
    ("feeder.toml", "115.0", '"high"', r"source sourcebus: base_kv is 'high'; give a finite number"),
])  # fmt: skip
def test_what_a_file_gets_wrong_is_named(folder, file, old, new, message):
    change(folder / file, old, new)
    with pytest.raises(FeederError, match=message):
        ThreePhaseFeeder.from_csv(folder)


def test_results_that_stand_beside_the_figures_are_left_out(folder):
    change(folder / "feeder.toml", "[source]", 'engine = "one"\n[golden]\nloss_kw = 1.0\n[source]')
    assert repr(ThreePhaseFeeder.from_csv(folder).network) == repr(load_feeder("ieee13-3ph").network)


def test_a_missing_file_is_named_or_stands_for_an_empty_table(folder):
    (folder / "capacitors.csv").unlink()
    assert ThreePhaseFeeder.from_csv(folder).n_capacitor == 0
    (folder / "buses.csv").unlink()
    with pytest.raises(FeederError, match=r"buses\.csv is missing"):
        ThreePhaseFeeder.from_csv(folder)


def test_shares_of_a_zip_load_are_written_and_read(folder):
    change(folder / "loads.csv", "vlow_pu", "vlow_pu,zip_pz,zip_pi,zip_pp,zip_qz,zip_qi,zip_qp")
    change(folder / "loads.csv", "671,671,delta,PQ", "671,671,delta,ZIP")
    change(folder / "loads.csv", "0.95,1.05,0.5", "0.95,1.05,0.5,0.2,0.3,0.5,0.1,0.2,0.7")
    feeder = ThreePhaseFeeder.from_csv(folder)
    assert feeder.network.phase_load.zip[:2] == ((0.2, 0.3, 0.5, 0.1, 0.2, 0.7), ())
    feeder.to_csv(folder / "again")
    assert repr(ThreePhaseFeeder.from_csv(folder / "again").network) == repr(feeder.network)


def test_a_text_that_a_file_cannot_give_back_is_not_written(folder):
    network = load_feeder("ieee13-3ph").network
    names = (" spaced", *network.phase_load.name[1:])
    feeder = ThreePhaseFeeder.from_network(replace(network, phase_load=replace(network.phase_load, name=names)))
    with pytest.raises(FeederError, match="' spaced' cannot be written"):
        feeder.to_csv(folder / "out")
    assert not (folder / "out").exists()
