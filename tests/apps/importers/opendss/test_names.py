"""Names that OpenDSS accepts: read without quotes, written to tables and read back."""

import string

import pytest

from dcgrid_env import FeederError, ThreePhaseFeeder
from dcgrid_env.apps.importers.opendss.dss_words import Word, words_of
from dcgrid_env.apps.importers.opendss.reading import read_circuit
from dcgrid_env.grid.three_phase_checks import node_names
from helpers.opendss_imports import apart_pu

dss = pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")

PLAIN = [sign for sign in string.punctuation if sign not in "!\"',.="]
"""Signs that need no quotes within a name, by OpenDSS's own parser."""


def lines(signs, quote=""):
    """For each sign a line and a transformer whose names and buses contain it."""
    text = ""
    for k, sign in enumerate(signs):
        line, bus = (f"{quote}{name.format(sign)}{quote}" for name in ("Line.l{}1", "b{}2"))
        text += (
            f"New {line} bus1=n bus2={bus} r1=1 x1=2 r0=2 x0=3\n"
            f"New Transformer.(t:{k})@x wdg=1 bus={bus} conn=wye kv=12.47 kva=500\n"
            f"~ wdg=2 bus=z{k} conn=delta kv=0.48 kva=500\n"
            f"New Load.#l&{k} bus1=z{k} conn=delta kv=0.48 kw=9\nOpen {line} 2\nClose {line} 2\n"
        )
    return text


@pytest.mark.parametrize(("signs", "quote"), [(PLAIN, ""), (["=", " ", ",", "!", "'", "(", "]", "//"], '"')])
def test_names_with_every_sign_are_read_and_written(signs, quote, master, tmp_path):
    found = read_circuit(master(lines(signs, quote)))
    assert set(found.network.phase_line.name) == {"l1", "l2", *(f"l{sign}1" for sign in signs)}
    assert {f"b{sign}2" for sign in signs} <= set(found.network.node.bus)
    assert set(found.network.admittance.name) == {f"transformer.(t:{k})@x" for k in range(len(signs))}
    assert apart_pu(found) < 2e-8
    feeder = ThreePhaseFeeder.from_network(found.network)
    feeder.to_csv(tmp_path / "tables")
    assert repr(ThreePhaseFeeder.from_csv(tmp_path / "tables").network) == repr(feeder.network)


def test_a_line_of_smart_ds_is_one_word_each():
    line = "New Line.l(r:sub-udt7) bus1=sub.1 kvs=(7.2 0.12)"
    assert words_of(line)[1:] == [Word("", "Line.l(r:sub-udt7)"), Word("bus1", "sub.1"), Word("kvs", "7.2 0.12", "(")]


@pytest.mark.parametrize(
    "line", ["redirect @x", "new x file=@a", "new x kvs=(1 @b)", 'new x kvs=["@b"]', "new x a=b,@c"]
)
def test_a_variable_is_refused_where_it_may_be_one(line):
    with pytest.raises(ValueError, match="variable of OpenDSS"):
        words_of(line)


def test_a_bus_cannot_name_a_file(master):
    with pytest.raises(FeederError, match="may name a file"):
        read_circuit(master('New Load.x bus1="file=shape.csv" kv=12.47 kw=9'))


def test_buses_with_blanks_in_a_list_of_nodes():
    assert node_names("650.a p q.b  r s.c") == [("650", "a"), ("p q", "b"), ("r s", "c")]
    assert node_names("650 651.a") == [("650 651", "a")]
    assert node_names("650.a 651") == [("650", "a"), ("651", "")]
