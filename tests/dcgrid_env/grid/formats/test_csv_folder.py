"""Figures and files that cannot be used: the message names the file, the line, the bus or branch and the field."""

import re

import numpy as np
import pytest

from dcgrid_env import Feeder, FeederError

NAN, INF = float("nan"), float("inf")


# --- figures given as tables ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("argument", "field"), [
    ("p_load_kw", "p_kw"), ("q_load_kvar", "q_kvar"), ("capacitor_kvar", "capacitor_kvar"),
])  # fmt: skip
@pytest.mark.parametrize("value", [NAN, INF, -INF])
def test_bus_figures_that_are_not_finite(build, tables, argument, field, value):
    figures = [*tables[argument][:3], value, tables[argument][4]]
    with pytest.raises(FeederError, match=f"'hand': bus c: {field} is {value}"):
        build(**{argument: figures})


@pytest.mark.parametrize("field", ["r_ohm", "x_ohm"])
@pytest.mark.parametrize("value", [NAN, INF, -0.1])
def test_impedances_that_are_not_finite_or_negative(build, field, value):
    with pytest.raises(FeederError, match=f"'hand': branch a-b: {field} is {value}"):
        build(**{field: [1.0, value, 1.0, 1.0]})


def test_negative_loads_and_capacitors_are_allowed(build):
    feeder = build(p_load_kw=[-40.0, 10.0, 1.0, 30.0, 20.0], capacitor_kvar=[-5.0, 0.0, 0.0, 0.0, 0.0])
    assert feeder.p_load_kw[feeder.index("d")] == -40.0
    assert feeder.capacitor_kvar[feeder.index("d")] == -5.0


@pytest.mark.parametrize("field", ["base_kv", "v0_pu"])
@pytest.mark.parametrize("value", [0.0, -1.0, NAN, INF])
def test_base_and_substation_voltage_are_positive(build, field, value):
    with pytest.raises(FeederError, match=f"'hand': feeder {field}: value is {value}"):
        build(**{field: value})


@pytest.mark.parametrize("argument", ["p_load_kw", "q_load_kvar", "capacitor_kvar", "r_ohm", "x_ohm"])
@pytest.mark.parametrize("length", [3, 6])
def test_columns_of_another_length(build, argument, length):
    field = {"p_load_kw": "p_kw", "q_load_kvar": "q_kvar"}.get(argument, argument)
    rows = "4 branch rows" if argument.endswith("ohm") else "5 bus rows"
    with pytest.raises(FeederError, match=f"'hand': {length} values of {field} for {rows}"):
        build(**{argument: [1.0] * length})


@pytest.mark.parametrize("changes", [
    {"to_bus": ["c", "b", "sub"]},
    {"x": [0.0, 1.0, 2.0, 3.0]},
    {"y": [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]},
    {"x": ["a", "b", "c", "d", "e"]},
    {"p_load_kw": ["much", 1.0, 1.0, 1.0, 1.0]},
    {"r_ohm": [None, 1.0, 1.0, 1.0]},
    {"base_kv": "10 kV"},
], ids=lambda changes: f"{next(iter(changes))}={next(iter(changes.values()))}")  # fmt: skip
def test_other_unusable_tables_are_feeder_errors(build, changes):
    try:
        build(**changes)
    except FeederError:
        return
    except (ValueError, TypeError, IndexError) as error:
        pytest.fail(f"{type(error).__name__} in place of FeederError: {error}")
    pytest.fail("no error")


# --- files ----------------------------------------------------------------------------------------------------------


def test_files_worked_by_hand(folder):
    feeder = Feeder.from_csv(folder())
    assert (feeder.name, feeder.base_kv, feeder.v0_pu) == ("hand", 10.0, 1.02)
    assert feeder.bus_ids == ("7", "3", "5")
    assert feeder.p_load_kw.tolist() == [0.0, 30.0, 50.0]
    assert feeder.q_load_kvar.tolist() == [0.0, 3.0, 5.0]
    assert feeder.capacitor_kvar.tolist() == [0.0, 0.0, 55.0]
    assert feeder.parent.tolist() == [0, 1]
    assert feeder.r_ohm.tolist() == [1.0, 0.25]
    assert feeder.x_ohm.tolist() == [2.0, 0.5]
    np.testing.assert_array_equal(feeder.x, [0.0, 0.5, NAN])
    np.testing.assert_array_equal(feeder.y, [0.0, 1.5, NAN])


def test_the_folder_may_be_a_string(folder):
    assert Feeder.from_csv(str(folder())).bus_ids == ("7", "3", "5")


def test_optional_columns_may_be_absent(folder):
    feeder = Feeder.from_csv(folder(buses="bus,p_kw,q_kvar\n3,30,3\n7,0,0\n5,50,5\n"))
    assert feeder.capacitor_kvar.tolist() == [0.0, 0.0, 0.0]
    assert np.isnan(feeder.x).all()


def test_column_order_spaces_blank_lines_and_line_ends_do_not_matter(folder):
    buses = "q_kvar,p_kw,bus\r\n3, 30 , 3\r\n\r\n0,0,7\r\n5,5e1,5\r\n"
    feeder = Feeder.from_csv(folder(buses=buses))
    assert feeder.bus_ids == ("7", "3", "5")
    assert feeder.p_load_kw.tolist() == [0.0, 30.0, 50.0]


def test_buses_named_by_text(folder):
    path = folder(
        feeder='name = "t"\nbase_kv = 10\nsubstation = "150r"\nv0_pu = 1\n',
        buses="bus,p_kw,q_kvar\n1,1,1\n150r,0,0\n",
        branches="from_bus,to_bus,r_ohm,x_ohm\n1,150r,1,1\n",
    )
    feeder = Feeder.from_csv(path)
    assert feeder.bus_ids == ("150r", "1")
    assert feeder.index("1") == 1


def test_a_substation_given_as_text_among_numbered_buses(folder):
    feeder = Feeder.from_csv(folder(feeder='name = "t"\nbase_kv = 10\nsubstation = "7"\nv0_pu = 1\n'))
    assert feeder.bus_ids == ("7", "3", "5")


@pytest.mark.parametrize("name", ["feeder", "buses", "branches"])
def test_missing_file(folder, name):
    path = folder(**{name: None})
    with pytest.raises(FeederError, match=rf"{name}\.(csv|toml) is missing"):
        Feeder.from_csv(path)


def test_missing_folder(tmp_path):
    with pytest.raises(FeederError, match=r"nowhere.*feeder\.toml is missing"):
        Feeder.from_csv(tmp_path / "nowhere")


@pytest.mark.parametrize("key", ["name", "base_kv", "substation", "v0_pu"])
def test_missing_key(folder, key):
    path = folder()
    head = path / "feeder.toml"
    head.write_text("\n".join(line for line in head.read_text().splitlines() if not line.startswith(key)))
    with pytest.raises(FeederError, match=rf"feeder\.toml: the key '{key}' is missing"):
        Feeder.from_csv(path)


@pytest.mark.parametrize(("name", "column"), [
    ("buses", "bus"), ("buses", "p_kw"), ("buses", "q_kvar"),
    ("branches", "from_bus"), ("branches", "to_bus"), ("branches", "r_ohm"), ("branches", "x_ohm"),
])  # fmt: skip
def test_missing_column(folder, name, column):
    path = folder()
    table = path / f"{name}.csv"
    table.write_text(re.sub(rf"\b{column}\b", "other", table.read_text(), count=1))
    with pytest.raises(FeederError, match=rf"{name}\.csv: the column '{column}' is missing; the file has .*other"):
        Feeder.from_csv(path)


@pytest.mark.parametrize(("name", "text", "said"), [
    ("buses", "bus,p_kw,q_kvar,capacitors_kvar\n3,30,3,9\n7,0,0,0\n5,5,5,0\n",
     r"buses\.csv: the column 'capacitors_kvar' is unknown; the columns are bus, p_kw, q_kvar, capacitor_kvar, x"),
    ("branches", "from_bus,to_bus,r_ohm,x_ohm,length\n3,5,1,1,2\n7,3,1,1,2\n",
     r"branches\.csv: the column 'length' is unknown; the columns are from_bus, to_bus, r_ohm, x_ohm, rating_a$"),
    ("buses", "bus,p_kw,q_kvar,p_kw\n3,30,3,9\n7,0,0,0\n5,5,5,0\n", r"the column 'p_kw' is there twice; leave one out"),
    ("branches", "from_bus,to_bus,r_ohm,x_ohm\n3,5,1,1\n7,3,1,1,2\n", r"line 3: \['2'\] is beyond the last column"),
    ("feeder", 'name = "t"\nbase_kv = 10\nsubstation = 7\nv0_pu = 1\nv_pu = 1.04\n',
     r"feeder\.toml: 'v_pu' is no key of a feeder; there are name, base_kv, substation, v0_pu, about, source, licence"),
])  # fmt: skip
def test_what_would_be_left_out_unnoticed_is_refused(folder, name, text, said):
    with pytest.raises(FeederError, match=said):
        Feeder.from_csv(folder(**{name: text}))


def test_texts_for_readers_are_allowed(folder):
    head = 'name = "t"\nbase_kv = 10\nsubstation = 7\nv0_pu = 1\nsource = "a paper"\nabout = "x"\nlicence = "MIT"\n'
    assert Feeder.from_csv(folder(feeder=head)).name == "t"


def test_a_folder_in_the_place_of_a_file_is_refused(folder):
    path = folder(buses=None)
    (path / "buses.csv").mkdir()
    with pytest.raises(FeederError, match=r"buses\.csv cannot be read \(Is a directory\); give a file"):
        Feeder.from_csv(path)


def test_empty_table(folder):
    with pytest.raises(FeederError, match=r"branches\.csv: the column 'from_bus' is missing"):
        Feeder.from_csv(folder(branches=""))


@pytest.mark.parametrize(("name", "text", "line", "field", "shown"), [
    ("buses", "bus,p_kw,q_kvar\n3,30,3\n7,none,0\n5,50,5\n", 3, "p_kw", "'none'"),
    ("buses", "bus,p_kw,q_kvar\n3,30,3\n7,0,0\n5,50,1.2.3\n", 4, "q_kvar", "'1.2.3'"),
    ("buses", "bus,p_kw,q_kvar\n3,,3\n7,0,0\n5,50,5\n", 2, "p_kw", "''"),
    ("buses", "bus,p_kw,q_kvar\n3,30,3\n7,0\n5,50,5\n", 3, "q_kvar", "''"),
    ("buses", "bus,p_kw,q_kvar,capacitor_kvar\n3,30,3,\n7,0,0,\n5,50,5,big\n", 4, "capacitor_kvar", "'big'"),
    ("buses", "bus,p_kw,q_kvar,x\n3,30,3,east\n7,0,0,\n5,50,5,\n", 2, "x", "'east'"),
    ("branches", "from_bus,to_bus,r_ohm,x_ohm\n3,5,1,1\n7,3,short,1\n", 3, "r_ohm", "'short'"),
])  # fmt: skip
def test_a_cell_that_is_no_number(folder, name, text, line, field, shown):
    with pytest.raises(FeederError, match=rf"{name}\.csv, line {line}: {field} is {re.escape(shown)}; give a number"):
        Feeder.from_csv(folder(**{name: text}))


@pytest.mark.parametrize(("name", "text", "line", "field"), [
    ("buses", "bus,p_kw,q_kvar\n3,30,3\n,0,0\n5,50,5\n", 3, "bus"),
    ("branches", "from_bus,to_bus,r_ohm,x_ohm\n3,5,1,1\n7, ,1,1\n", 3, "to_bus"),
])  # fmt: skip
def test_a_bus_without_a_name(folder, name, text, line, field):
    with pytest.raises(FeederError, match=rf"{name}\.csv, line {line}: {field} is empty"):
        Feeder.from_csv(folder(**{name: text}))


def test_a_figure_written_as_nan_is_refused(folder):
    with pytest.raises(FeederError, match="line 4: p_kw is 'nan'; give a finite number"):
        Feeder.from_csv(folder(buses="bus,p_kw,q_kvar\n3,30,3\n7,0,0\n5,nan,5\n"))


def test_an_impedance_below_zero_in_a_file_is_refused(folder):
    with pytest.raises(FeederError, match="branch 7-3: x_ohm is -2"):
        Feeder.from_csv(folder(branches="from_bus,to_bus,r_ohm,x_ohm\n3,5,1,1\n7,3,1,-2\n"))


@pytest.mark.parametrize("key", ["base_kv", "v0_pu"])
@pytest.mark.parametrize("value", ['"12.66"', "true", "[1.0]", "2024-01-01"])
def test_toml_values_of_another_type(folder, key, value):
    path = folder()
    head = path / "feeder.toml"
    head.write_text(re.sub(rf"{key} = .*", f"{key} = {value}", head.read_text()))
    with pytest.raises(FeederError, match=rf"feeder\.toml: {key} is .*; give a number"):
        Feeder.from_csv(path)


@pytest.mark.parametrize(("key", "value"), [("base_kv", "0"), ("base_kv", "-4.16"), ("v0_pu", "nan"), ("v0_pu", "inf")])
def test_toml_values_out_of_range(folder, key, value):
    path = folder()
    head = path / "feeder.toml"
    head.write_text(re.sub(rf"{key} = .*", f"{key} = {value}", head.read_text()))
    with pytest.raises(FeederError, match=rf"'hand': feeder {key}: value is {value}"):
        Feeder.from_csv(path)


def test_toml_that_does_not_parse(folder):
    with pytest.raises(FeederError, match=r"feeder\.toml: .*line 2"):
        Feeder.from_csv(folder(feeder='name = "hand"\nbase_kv = = 3\n'))


def test_a_feeder_with_a_loop_in_files(folder, tmp_path):
    branches = "from_bus,to_bus,r_ohm,x_ohm,rating_a\n3,5,1,1,\n7,3,1,2,90\n5,7,1,1,80\n"
    feeder = Feeder.from_csv(folder(branches=branches))
    assert feeder.branch_names == ("branch 7-3", "branch 7-5", "branch 3-5")
    feeder.to_csv(tmp_path / "again")
    again = Feeder.from_csv(tmp_path / "again")
    assert again.bus_ids == feeder.bus_ids
    for field in ("parent", "loop_ends", "r_ohm", "x_ohm", "rating_a"):
        np.testing.assert_array_equal(getattr(again, field), getattr(feeder, field))


def test_a_bus_name_with_two_minus_signs_is_text(folder):
    path = folder(buses="bus,p_kw,q_kvar\n--3,30,3\n7,0,0\n", branches="from_bus,to_bus,r_ohm,x_ohm\n--3,7,1,1\n")
    assert Feeder.from_csv(path).bus_ids == ("7", "--3")
