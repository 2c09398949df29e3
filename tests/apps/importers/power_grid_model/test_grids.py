"""power-grid-model's files: voltages are those of its power flow, what cannot be is refused by name, and grids come
back."""

import json

import pytest

from dcgrid_env import Feeder, FeederError, load_feeder
from dcgrid_env.apps.importers.power_grid_model import read_power_grid_model, write_power_grid_model
from helpers.imports import apart_pu, assert_same_feeder, fates

pytest.importorskip("power_grid_model", reason="power-grid-model is not installed (extra power-grid-model)")


def branch(i, a, b, closed=(1, 1), **fields):
    return {"id": i, "from_node": a, "to_node": b, "from_status": closed[0], "to_status": closed[1], **fields}


def grid():
    """A grid with every component that a balanced feeder can hold, taps off their middle, ends open."""
    volts = [110e3, 20e3, 20e3, 400.0, 400.0, 400.0, 20e3, 20e3, 20e3]
    transformer = {"sn": 63e4, "uk": 0.04, "pk": 6e3, "i0": 0.01, "p0": 1e3, "winding_from": 2, "winding_to": 2}
    taps = {"tap_side": 1, "tap_pos": 1, "tap_min": 5, "tap_max": -5, "tap_nom": 2, "tap_size": 500.0, "pk_min": 7e3}
    main = {"u1": 112e3, "u2": 20.5e3, "sn": 40e6, "uk": 0.12, "pk": 1.5e5, "i0": 0.004, "p0": 3e4, "clock": 5}
    main |= {"winding_from": 2, "winding_to": 1, "tap_side": 0, "tap_pos": 3, "tap_min": -9, "tap_max": 9, "tap_nom": 0}
    cable = {"r1": 0.8, "x1": 0.5, "c1": 1e-6, "tan1": 0.01, "i_n": 300.0}
    at = {"status": 1, "type": 0}
    return {
        "node": [{"id": i, "u_rated": u} for i, u in enumerate(volts, 1)],
        "source": [{"id": 10, "node": 1, "status": 1, "u_ref": 1.03, "sk": 2e9, "rx_ratio": 0.2}],
        "transformer": [
            branch(11, 1, 2, **main, tap_size=1500.0, uk_min=0.13, uk_max=0.11),
            branch(12, 4, 3, u1=410.0, u2=20e3, clock=0, **transformer, **taps),
            branch(13, 3, 8, (1, 0), u1=20e3, u2=20e3, clock=0, **transformer, **taps),
        ],
        "line": [
            branch(14, 2, 3, **cable),
            branch(15, 3, 2, r1=1.8, x1=1.5, c1=1e-6, tan1=0.01, i_n=100.0),
            branch(16, 4, 5, r1=0.03, x1=0.01, c1=1e-7, tan1=0.0),
            branch(17, 7, 3, (0, 1), **cable),
        ],
        "generic_branch": [branch(18, 5, 6, r1=0.02, x1=0.01, g1=0.001, b1=0.002, k=1.02, theta=0.1, sn=1e5)],
        "link": [branch(19, 3, 9)],
        "sym_load": [
            {"id": 20, "node": 5, "p_specified": 1e5, "q_specified": 3e4, **at},
            {"id": 21, "node": 6, "p_specified": 5e4, "q_specified": 3e4, "status": 1, "type": 1},
        ],
        "sym_gen": [{"id": 22, "node": 9, "p_specified": 1e6, "q_specified": -3e4, **at}],
        "asym_load": [{"id": 23, "node": 5, "p_specified": [2e4] * 3, "q_specified": [1e3] * 3, **at}],
        "shunt": [{"id": 24, "node": 3, "status": 1, "g1": 1e-5, "b1": 2e-4, "g0": 0.0, "b0": 0.0}],
        "sym_voltage_sensor": [{"id": 25, "measured_object": 2, "u_measured": 20e3, "u_sigma": 1.0}],
    }


def written(tmp_path, data, **head):
    path = tmp_path / "grid.json"
    whole = {"version": "1.0", "type": "input", "is_batch": False, "attributes": {}, "data": data} | head
    path.write_text(json.dumps(whole))
    return path


def test_voltages_of_a_grid_of_all_kinds_are_power_grid_models(tmp_path):
    imported = read_power_grid_model(written(tmp_path, grid()))
    assert apart_pu(imported) < 1e-7
    found = fates(imported)
    assert found["bus", "nothing lost"] == ("7", "8")
    assert imported.bus_of["9"] == "3"
    assert imported.network.source.bus == ("source-10",)
    assert ("sym_voltage_sensor", "nothing lost") in found


def test_charging_goes_with_the_frequency(tmp_path):
    data = grid()
    data["line"][0]["c1"] = 1e-4
    at_50, at_60 = (read_power_grid_model(written(tmp_path, data), frequency_hz=f) for f in (50.0, 60.0))
    assert apart_pu(at_60) < 1e-7
    assert abs(at_50.v_pu["3"] - at_60.v_pu["3"]) > 1e-5


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda d: d["line"].append(branch(30, 2, 9, r1=1.0, x1=1.0, c1=0.0, tan1=0.0)), "parallel"),
        (lambda d: d["line"].append(branch(30, 1, 9, r1=1.0, x1=1.0, c1=0.0, tan1=0.0)), "closes a loop"),
        (
            lambda d: d["source"].append({"id": 30, "node": 5, "status": 1, "u_ref": 1.0}),
            "source 30: it feeds the same",
        ),
        (lambda d: d["node"][2].update(u_rated=-1.0), "node 3: u_rated"),
        (lambda d: d["line"][0].update(to_node=99), "line 14: to_node"),
        (lambda d: d["line"][0].update(r1="much"), "line, row 1, id 14: r1 is 'much'; give a number"),
        (lambda d: d["line"][0].update(from_status=True), "from_status is 'True'; give a number"),
        (lambda d: d["line"][0].update(from_status=300), "from_status is 300; give a whole number of -127 to 127"),
        (lambda d: d["asym_load"][0].update(p_specified=[1.0, 2.0]), "p_specified is [1.0, 2.0]; give 3 numbers"),
        (lambda d: d["sym_load"][0].update(p_specified=None), "sym_load 20: p_specified"),
        (lambda d: d["line"][0].pop("id"), "id"),
        (lambda d: d.update(lines=[]), "'lines' is no component"),
        (lambda d: d.pop("source"), "no source"),
        (lambda d: d.clear(), "it has no node"),
    ],
)
def test_what_cannot_be_is_refused_by_name(tmp_path, change, told):
    data = grid()
    change(data)
    path = written(tmp_path, data)
    if told == "parallel":
        assert apart_pu(read_power_grid_model(path)) < 1e-7
        return
    with pytest.raises(FeederError, match=r"grid\.json") as refused:
        read_power_grid_model(path)
    assert told in str(refused.value)


def test_constant_current_and_tap_regulators_are_lost_by_name(tmp_path):
    data = grid()
    data["sym_load"][0]["type"] = 2
    data["transformer_tap_regulator"] = [
        {"id": 31, "regulated_object": 11, "status": 1, "control_side": 1, "u_set": 20e3, "u_band": 500.0}
    ]
    path = written(tmp_path, data)
    with pytest.raises(
        FeederError, match=r"sym_load 20: .* constant power.*--allow sym_load,transformer_tap_regulator"
    ):
        read_power_grid_model(path)
    read_power_grid_model(path, allow=["sym_load", "transformer_tap_regulator"])


@pytest.mark.parametrize("kind", ["asym_load", "asym_gen"])
@pytest.mark.parametrize("law", [0, 1])
def test_phases_that_differ_are_lost_by_name(kind, law, tmp_path):
    data = grid()
    data[kind] = [data.pop("asym_load")[0] | {"q_specified": [1e3, 1e3, 5e3], "type": law}]
    path = written(tmp_path, data)
    with pytest.raises(FeederError, match=rf"{kind} 23: its phases differ.*--allow {kind} accepts that"):
        read_power_grid_model(path)
    found = fates(read_power_grid_model(path, allow=[kind]))
    assert found[kind, "lost"] == ("23",)
    assert (kind, "taken") not in found
    data[kind][0]["status"] = 0
    assert fates(read_power_grid_model(written(tmp_path, data)))[kind, "nothing lost"] == ("23",)


@pytest.mark.parametrize("sk", [1e15, 1e18, 1e20, 1e300])
def test_a_source_of_very_large_short_circuit_power_is_ideal(sk, tmp_path):
    data = grid()
    data["source"][0].update(sk=sk, u_ref_angle=0.2)
    imported = read_power_grid_model(written(tmp_path, data))
    assert imported.network.source.bus == ("1",)
    assert imported.v_pu["1"] == pytest.approx(1.03, abs=1e-9)
    assert apart_pu(imported) < 1e-7
    assert fates(imported)["source", "nothing lost"] == ("10",)
    data["source"][0]["sk"] = float("inf")
    with pytest.raises(FeederError, match="sk is inf; give a finite number"):
        read_power_grid_model(written(tmp_path, data))


def test_a_batch_and_two_fields_of_one_name_are_refused(tmp_path):
    with pytest.raises(FeederError, match="give one scenario of type 'input'"):
        read_power_grid_model(written(tmp_path, grid(), is_batch=True))
    path = written(tmp_path, grid())
    path.write_text(path.read_text().replace('"r1":', '"r1": 1.0, "r1":', 1))
    with pytest.raises(FeederError, match="'r1' is there twice"):
        read_power_grid_model(path)


@pytest.mark.parametrize("name", ["ieee33", "khodr141"])
def test_a_feeder_comes_back_from_a_file(tmp_path, name):
    write_power_grid_model(load_feeder(name), tmp_path / "grid.json")
    imported = read_power_grid_model(tmp_path / "grid.json", bus_names=True)
    assert apart_pu(imported) < 1e-7
    assert_same_feeder(load_feeder(name), Feeder.from_network(imported.network))


def test_a_grid_of_all_kinds_comes_back(tmp_path):
    feeder = Feeder.from_network(read_power_grid_model(written(tmp_path, grid())).network)
    write_power_grid_model(feeder, tmp_path / "again.json")
    again = read_power_grid_model(tmp_path / "again.json", bus_names=True)
    assert_same_feeder(feeder, Feeder.from_network(again.network))
