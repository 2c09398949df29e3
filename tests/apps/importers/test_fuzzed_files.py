"""Files that are damaged: each is refused in one line that names it, or read; never a traceback, a hang, a value
unheeded."""

import json
import random
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from dcgrid_env import Feeder, FeederError, ThreePhaseFeeder, load_feeder
from dcgrid_env.apps.importers.matpower import read_matpower, write_matpower
from dcgrid_env.apps.importers.opendss.reading import read_circuit
from dcgrid_env.apps.importers.pandapower import read_pandapower, write_pandapower
from dcgrid_env.apps.importers.power_grid_model import read_power_grid_model, write_power_grid_model
from helpers.fuzzing import Cell, cells_of_csv, facts, mutated_bytes, mutated_value, outcome, same_number
from helpers.opendss_fuzzing import MESHED, RADIAL

DAMAGED = "grid"
"""Folder of the damaged files."""
FORMATS = [
    "csv",
    "three-phase csv",
    "three-phase csv with loops",
    "three-phase csv with regulators",
    "matpower",
    "pandapower",
    "power-grid-model",
]


def small_feeder():
    """Six buses with a shunt, a transformer off its nominal ratio, ratings and a generator."""
    return Feeder.from_tables(
        name="small",
        base_kv=20.0,
        substation="1",
        v0_pu=1.02,
        bus_ids=["1", "2", "3", "4", "5", "6"],
        p_load_kw=[0.0, 100.0, -50.0, 30.0, 20.0, 10.0],
        q_load_kvar=[0.0, 30.0, 5.0, 10.0, 5.0, 2.0],
        from_bus=["1", "2", "2", "4", "5"],
        to_bus=["2", "3", "4", "5", "6"],
        r_ohm=[0.3, 0.4, 1.0, 2.0, 3.0],
        x_ohm=[0.2, 0.3, 4.0, 1.0, 1.0],
        shunt_kw=[0.0, 1.0, 0.0, 0.5, 0.0, 0.0],
        shunt_kvar=[0.0, 20.0, 0.0, 5.0, 0.0, 0.0],
        voltage_ratio=[1.0, 1.0, 1.0, 1.03, 1.03, 1.03],
        bus_base_kv=[20.0, 20.0, 20.0, 0.4, 0.4, 0.4],
        rating_a=[200.0, 150.0, 30.0, 25.0, 20.0],
    )


def from_opendss(script, folder):
    """The feeder of an OpenDSS script."""
    path = folder / "Master.dss"
    path.write_text(script)
    return ThreePhaseFeeder.from_network(read_circuit(path, allow=["isource"]).network)


class Format:
    """A format's file of the small feeder, how it is read, and its figures that decide the feeder."""

    def __init__(self, name, folder):
        self.name = name
        folder.mkdir()
        feeder, file = small_feeder(), folder / ("grid.m" if name == "matpower" else "grid.json")
        if name == "csv":
            feeder.to_csv(folder)
            self.read = Feeder.from_csv
        elif name == "three-phase csv":
            load_feeder("ieee13-3ph").to_csv(folder)
            self.read = ThreePhaseFeeder.from_csv
        elif name.startswith("three-phase csv"):
            from_opendss(MESHED if name.endswith("loops") else RADIAL, folder.parent).to_csv(folder)
            self.read = ThreePhaseFeeder.from_csv
        else:
            reader, writer = {
                "matpower": (read_matpower, write_matpower),
                "pandapower": (read_pandapower, write_pandapower),
                "power-grid-model": (read_power_grid_model, write_power_grid_model),
            }[name]
            writer(feeder, file)
            self.read = lambda folder: Feeder.from_network(reader(folder / file.name).network)
        self.files = {path.name: path.read_bytes() for path in sorted(folder.iterdir())}
        self.cells = getattr(self, f"cells_of_{re.sub(r'[^a-z]', '_', name)}")()
        # From a folder of the name that the damaged files get: a feeder may be called after it.
        self.facts = facts(outcome(self.read, self.files, folder / DAMAGED))

    def cells_of_csv(self):
        buses = cells_of_csv("buses.csv", self.files["buses.csv"], {"p_kw", "q_kvar", "shunt_kvar"})
        return buses + cells_of_csv("branches.csv", self.files["branches.csv"], {"r_ohm", "x_ohm", "rating_a"})

    def cells_of_three_phase_csv(self):
        columns = {"loads.csv": {"p_kw", "q_kvar"}, "lines.csv": {"r_aa_ohm", "x_aa_ohm", "b_aa_us"}}
        return [cell for file, wanted in columns.items() for cell in cells_of_csv(file, self.files[file], wanted)]

    def cells_of_three_phase_csv_with_loops(self):
        """The figures of the matrices: several in one cell."""
        text, found, at = self.files["admittances.csv"].decode(), [], 0
        header = text.split("\n", 1)[0].split(",")
        for line in text.split("\n"):
            for column, cell in zip(header, line.split(","), strict=False):
                if column in ("g_s", "b_s") and cell != column:
                    for figure in re.finditer(r"[^ ]+", cell):
                        if float(figure.group()) != 0:
                            span = (at + figure.start(), at + figure.end())
                            found.append(Cell("admittances.csv", span, (column,)))
                at += len(cell) + 1
        return found + self.cells_of_three_phase_csv()

    def cells_of_three_phase_csv_with_regulators(self):
        columns = {
            "regulators.csv": {"vreg_v", "band_v", "pt_ratio", "ct_primary_a", "r_v", "x_v", "tap"},
            "transformers.csv": {"kva", "kv_ll_from", "kv_ll_to", "r_percent", "x_percent"},
            "capacitors.csv": {"kvar", "leg_kv"},
        }
        return [cell for file, wanted in columns.items() for cell in cells_of_csv(file, self.files[file], wanted)]

    def cells_of_matpower(self):
        text, found = self.files["grid.m"].decode(), []
        columns = {"bus": (2, 3, 4, 5, 9), "branch": (2, 3, 5, 8)}
        for table, wanted in columns.items():
            begin = text.index(f"mpc.{table} = [")
            for row in re.finditer(r"^\t.*;$", text[begin : text.index("];", begin)], re.MULTILINE):
                cells = list(re.finditer(r"[^\s;]+", row.group()))
                for k in wanted:
                    if float(cells[k].group()) != 0:
                        at = begin + row.start()
                        found.append(Cell("grid.m", (at + cells[k].start(), at + cells[k].end()), (f"mpc.{table}",)))
        return found

    def cells_of_pandapower(self):
        return self.cells_by_key({
            "load": {"p_mw", "q_mvar", "scaling"}, "line": {"r_ohm_per_km", "x_ohm_per_km", "max_i_ka"},
            "trafo": {"vn_hv_kv", "vn_lv_kv", "vk_percent", "sn_mva"}, "shunt": {"p_mw", "q_mvar"},
            "ext_grid": {"vm_pu"},
        })  # fmt: skip

    def cells_by_key(self, wanted):
        """Tables stand within the file as texts: their figures have no quotes around them there."""
        text, found = self.files["grid.json"].decode(), []
        for table, columns in wanted.items():
            begin = text.index(f'"{table}": {{')
            begin = text.index('\\"columns\\":', begin)
            header = re.findall(r'\\"(\w+)\\"', text[begin : text.index("]", begin)])[1:]
            begin = text.index('\\"data\\":[[', begin) + len('\\"data\\":[')
            for row in re.finditer(r"\[([^\]]*)\]", text[begin : text.index("]]", begin) + 1]):
                at = begin + row.start(1)
                for column, cell in zip(header, re.split(r",", row.group(1)), strict=False):
                    if column in columns and re.fullmatch(r"-?[0-9.]+(e-?[0-9]+)?", cell) and float(cell) != 0:
                        found.append(Cell("grid.json", (at, at + len(cell)), (table, column)))
                    at += len(cell) + 1
        return found

    def cells_of_power_grid_model(self):
        text, found = self.files["grid.json"].decode(), []
        fields = ("p_specified", "q_specified", "r1", "x1", "i_n", "u_ref", "k", "sn", "b1", "u_rated")
        for match in re.finditer(rf'"({"|".join(fields)})": (-?[0-9.]+(?:e-?[0-9]+)?)', text):
            if float(match[2]) != 0:
                found.append(Cell("grid.json", match.span(2), (match[1],)))
        return found


@pytest.fixture(scope="module")
def formats(tmp_path_factory):
    for module in ("pandapower", "power_grid_model", "opendssdirect"):
        pytest.importorskip(module, reason=f"{module} is not installed")
    folder = tmp_path_factory.mktemp("whole")
    return {name: Format(name, folder / name.replace(" ", "-")) for name in FORMATS}


def check_bytes(form, seed, folder):
    files = mutated_bytes(form.files, random.Random(seed))
    found = outcome(form.read, files, folder)
    if not isinstance(found, FeederError):
        assert np.all(np.isfinite(found.r_ohm if isinstance(found, Feeder) else found.p_load_kw))
        again = folder.parent / "again"
        shutil.rmtree(again, ignore_errors=True)
        found.to_csv(again)
        assert facts(type(found).from_csv(again)) == facts(found)


def check_value(form, seed, folder):
    rng = random.Random(seed)
    cell = rng.choice(form.cells)
    files, was, text = mutated_value(form.files, cell, rng)
    found = outcome(form.read, files, folder)
    if isinstance(found, FeederError):
        return
    if not same_number(was, text):
        assert facts(found) != form.facts, f"{cell.names} {was} -> {text!r} is neither refused nor in the feeder"


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.slow
def test_a_file_with_other_bytes_is_refused_by_name_or_read(formats, name, tmp_path):
    for seed in range(6 if name == "pandapower" else 30):
        check_bytes(formats[name], seed, tmp_path / DAMAGED)


@pytest.mark.parametrize("name", FORMATS)
def test_a_figure_that_is_changed_is_refused_or_in_the_feeder(formats, name, tmp_path):
    for seed in range(4 if name == "pandapower" else 20):
        check_value(formats[name], seed, tmp_path / DAMAGED)


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_hundreds_of_damaged_files(formats, name, tmp_path):
    for seed in range(150):
        check_bytes(formats[name], 1000 + seed, tmp_path / DAMAGED)
        check_value(formats[name], 1000 + seed, tmp_path / DAMAGED)


@pytest.mark.parametrize("name", FORMATS)
def test_the_error_of_a_figure_names_its_place(formats, name, tmp_path):
    form = formats[name]
    for cell in form.cells[:: max(1, len(form.cells) // 5)]:
        data = form.files[cell.file]
        files = form.files | {cell.file: data[: cell.span[0]] + b"1x" + data[cell.span[1] :]}
        found = outcome(form.read, files, tmp_path / DAMAGED)
        assert isinstance(found, FeederError)
        if "csv" in name or name == "matpower":
            assert all(word in str(found) for word in (cell.file, *cell.names)), str(found)
            assert re.search(r"line \d+", str(found))
        else:
            assert Path(cell.file).name in str(found)


def test_integers_of_a_feeders_head_are_numbers(formats, tmp_path):
    form = formats["three-phase csv with loops"]
    head = form.files["feeder.toml"].decode()
    for was, text in (("frequency_hz = 60.0", "frequency_hz = 0x32"), ("angle_deg = 0.0", "angle_deg = 30"),
                      ("r_ohm = [[0.0133333333333", "r_ohm = [[99999999")):  # fmt: skip
        assert was in head
        files = form.files | {"feeder.toml": head.replace(was, text).encode()}
        found = outcome(form.read, files, tmp_path / DAMAGED)
        assert isinstance(found, ThreePhaseFeeder)
        found.to_csv(tmp_path / "again")
        assert facts(ThreePhaseFeeder.from_csv(tmp_path / "again")) == facts(found)
    files = form.files | {"feeder.toml": head.replace("angle_deg = 0.0", f"angle_deg = 1{'0' * 400}").encode()}
    assert "a number is too large; give one below 1e308" in str(outcome(form.read, files, tmp_path / DAMAGED))


def test_rated_powers_that_make_an_impedance_infinite_are_refused(formats, tmp_path):
    form = formats["three-phase csv with regulators"]
    for name, was, field in (("transformers.csv", b",500.0,", "kva"), ("regulators.csv", b",900.0,", "kva_per_phase")):
        assert was in form.files[name]
        files = form.files | {name: form.files[name].replace(was, b",1e-320,", 1)}
        found = outcome(form.read, files, tmp_path / DAMAGED)
        assert f"{field} is 1e-320; give at least 1e-100" in str(found)
        files = form.files | {name: form.files[name].replace(was, b",1e-9,", 1)}
        found = outcome(form.read, files, tmp_path / DAMAGED)
        assert f"{field} is 1e-09; give at least 1e-06 kVA" in str(found)


def test_the_error_of_a_json_figure_names_table_row_and_field(formats, tmp_path):
    net = json.loads(formats["pandapower"].files["grid.json"])
    table = json.loads(net["_object"]["line"]["_object"])
    table["data"][2][table["columns"].index("r_ohm_per_km")] = "much"
    net["_object"]["line"]["_object"] = json.dumps(table)
    found = outcome(formats["pandapower"].read, {"grid.json": json.dumps(net).encode()}, tmp_path / DAMAGED)
    assert "table line, index 2: r_ohm_per_km is 'much'; give a number" in str(found)
    grid = json.loads(formats["power-grid-model"].files["grid.json"])
    grid["data"]["line"][1]["r1"] = "much"
    found = outcome(formats["power-grid-model"].read, {"grid.json": json.dumps(grid).encode()}, tmp_path / DAMAGED)
    assert "line, row 2, id" in str(found)
    assert "r1 is 'much'; give a number" in str(found)
