"""Component tables: to a folder and back, to a feeder and back, and what a balanced feeder refuses."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcgrid_env import Feeder, FeederError, load_feeder
from dcgrid_env.grid.formats.csv_folder import read_csv, write_csv
from dcgrid_env.grid.network import (
    CapacitorTable,
    LineTable,
    LoadTable,
    Network,
    NodeTable,
    ShuntTable,
    SourceTable,
    SwitchTable,
    bus_numbers,
)
from helpers.feeders import BALANCED

FIGURE = st.floats(-1e8, 1e8).filter(lambda value: abs(value) > 1e-96)  # within the limits of a feeder
TEXT = st.text(st.characters(exclude_categories=["Cc", "Cs", "Zs", "Zl", "Zp"]), min_size=1, max_size=6)


@st.composite
def networks(draw):
    """Balanced radial networks; buses with and without a load, a capacitor and coordinates."""
    bus = draw(st.lists(TEXT | st.integers(-9, 99).map(str), min_size=1, max_size=8, unique=True))
    n = len(bus)
    coordinate = st.lists(
        FIGURE.map(lambda value: value / 1e3) | st.just(0.0) | st.just(float("nan")), min_size=n, max_size=n
    )
    loaded, shunted = (draw(st.lists(st.sampled_from(bus), unique=True).map(lambda b: sorted(b, key=bus.index)))
                       for _ in range(2))  # fmt: skip
    ohm = st.lists(FIGURE.map(lambda value: abs(value) / 1e3) | st.just(0.0), min_size=n - 1, max_size=n - 1)

    def figures(buses):
        return draw(st.lists(FIGURE, min_size=len(buses), max_size=len(buses)))

    return Network(
        name=draw(st.text(st.characters(exclude_categories=["Cs"]))),
        source=SourceTable([bus[0]], [draw(st.floats(0.1, 500.0))], [draw(st.floats(0.5, 1.5))]),
        node=NodeTable(bus, [0] * n, draw(coordinate), draw(coordinate)),
        line=LineTable([bus[draw(st.integers(0, k))] for k in range(n - 1)], bus[1:], draw(ohm), draw(ohm)),
        load=LoadTable(loaded, [0] * len(loaded), figures(loaded), figures(loaded)),
        shunt=ShuntTable(shunted, [0] * len(shunted), figures(shunted)),
    )


def assert_same(a, b):
    for field in dataclasses.fields(a):
        one, two = getattr(a, field.name), getattr(b, field.name)
        if isinstance(one, np.ndarray):
            np.testing.assert_array_equal(one, two, strict=True)
        else:
            assert repr(one) == repr(two)  # NaN is no equal of itself


@given(networks())
@pytest.mark.slow
def test_a_network_comes_back_from_its_folder(tmp_path_factory, network):
    folder = tmp_path_factory.mktemp("network")
    write_csv(network, folder)
    assert_same(read_csv(folder), network)


@given(networks())
@pytest.mark.slow
def test_a_feeder_comes_back_from_its_tables(network):
    feeder = Feeder.from_network(network)
    assert_same(Feeder.from_network(feeder.to_network()), feeder)


@pytest.mark.parametrize("name", BALANCED)
def test_a_named_feeder_comes_back_from_a_folder(tmp_path, name):
    load_feeder(name).to_csv(tmp_path / name)
    assert_same(Feeder.from_csv(tmp_path / name), load_feeder(name))


def small(**changes):
    tables = {
        "source": SourceTable(["a"], [10.0], [1.02]),
        "node": NodeTable(["b", "a"], [0, 0], [1.0, 0.0], [0.0, 0.0]),
        "line": LineTable(["b"], ["a"], [1.0], [2.0]),
        "load": LoadTable(["b", "b"], [0, 0], [10.0, 5.0], [1.0, 2.0]),
    }
    return Network(name="small", **tables | changes)


def test_loads_of_a_bus_are_added_up(tmp_path):
    feeder = Feeder.from_network(small())
    assert feeder.bus_ids == ("a", "b")
    assert feeder.p_load_kw.tolist() == [0.0, 15.0]
    assert feeder.q_load_kvar.tolist() == [0.0, 3.0]
    write_csv(small(), tmp_path)
    assert_same(Feeder.from_csv(tmp_path), feeder)


def test_buses_given_as_numbers_become_text():
    assert NodeTable([1, np.int64(2)], [0, 0], [0.0, 0.0], [0.0, 0.0]).bus == ("1", "2")  # pyright: ignore
    with pytest.raises(FeederError, match=r"bus 1\.5 is neither text nor a whole number"):
        LoadTable([1.5], [0], [0.0], [0.0])  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(("buses", "numbers"), [
    (["0", "-3", "18"], (0, -3, 18)), (["1", "12a"], None), (["018"], None), (["-0"], None), (["1.0"], None),
    (["١"], None),  # a digit, but not one that Python would write
])  # fmt: skip
def test_numbers_of_buses(buses, numbers):
    assert bus_numbers(buses) == numbers


@pytest.mark.parametrize(("changes", "message"), [
    ({"switch": SwitchTable(["sw"], ["b"], ["a"], ["abc"], ["closed"], [0.0], [0.0])},
     "switch sw cannot be used; balanced feeders take lines, shunts, loads, a source"),
    ({"capacitor": CapacitorTable(["c"], ["b"], ["wye"], [2.4], [[1.0, 0.0, 0.0]], ["on"])},
     "capacitor c cannot be used; balanced feeders take lines, shunts, loads, a source"),
    ({"source": SourceTable()}, "0 sources; give one"),
    ({"source": SourceTable(["a", "b"], [10.0, 10.0], [1.0, 1.0])}, "2 sources; give one"),
    ({"load": LoadTable(["b"], [1], [1.0], [1.0])}, "load at bus 'b' is of phase 1; balanced feeders have phase 0"),
    ({"shunt": ShuntTable(["c"], [0], [1.0])}, "shunt at the unknown bus 'c'; add it to the nodes"),
    ({"node": NodeTable(["b", "a"], [0, 2], [0.0, 0.0], [0.0, 0.0])}, "node at bus 'a' is of phase 2"),
])  # fmt: skip
def test_what_no_balanced_feeder_takes_is_refused_by_name(tmp_path, changes, message):
    for use in (Feeder.from_network, lambda network: write_csv(network, tmp_path / "out")):
        with pytest.raises(FeederError, match=f"feeder 'small': {message}"):
            use(small(**changes))
    assert not (tmp_path / "out").exists()


def test_columns_of_different_lengths_are_refused():
    with pytest.raises(FeederError, match="LineTable: 2 values of r_ohm for 1 rows"):
        LineTable(["a"], ["b"], [1.0, 2.0], [1.0])


@pytest.mark.parametrize("bus", [" b", "b\n", "", "b\x85c"])
def test_a_bus_that_a_file_cannot_give_back_is_not_written(tmp_path, bus):
    network = small(node=NodeTable([bus, "a"], [0, 0], [0.0, 0.0], [0.0, 0.0]), load=LoadTable(), line=LineTable())
    with pytest.raises(FeederError, match="cannot be written; leave out spaces at its ends and line ends"):
        write_csv(network, tmp_path / "out")
    assert not (tmp_path / "out").exists()
