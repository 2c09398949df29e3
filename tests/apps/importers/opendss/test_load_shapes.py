"""Load shapes of OpenDSS scripts: imported profiles give OpenDSS's voltages at each step of its time modes."""

import numpy as np
import pytest

from dcgrid_env import Scenario, ThreePhaseFeeder, load_feeder
from dcgrid_env.apps.importers.opendss import read_opendss, write_imported_profiles
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.baselines.rollout import transitions
from helpers.opendss_text import script_of
from helpers.places import ROOT

dss = pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")

DAY = " ".join(f"{0.6 + 0.4 * np.sin(k / 3.0):.6f}" for k in range(24))
SHAPES = f"""
New LoadShape.home npts=24 interval=1 mult=({DAY})
New LoadShape.shop npts=48 minterval=30 mult=({DAY} {DAY}) qmult=({" ".join(reversed(DAY.split()))} {DAY})
New LoadShape.week npts=168 interval=1 mult=({" ".join([DAY] * 3)} {" ".join(["0.5"] * 96)})
New LoadShape.kw npts=24 interval=1 useactual=yes mult=({" ".join(str(20 + k) for k in range(24))})
New LoadShape.kvar npts=24 interval=1 useactual=yes mult=({" ".join(str(20 + k) for k in range(24))}) qmult=({DAY})
New LoadShape.uneven npts=3 hour=(0 5 24) mult=(1 0.5 1)
"""
LOADS = """
New Load.a bus1=m.1 phases=1 kv=7.2 kw=60 pf=0.9 daily=home
New Load.b bus1=m.2 phases=1 kv=7.2 kw=60 kvar=20 model=2 daily=shop yearly=week
New Load.c bus1=m.3 phases=1 kv=7.2 kw=60 pf=0.95 model=5 daily=kw
New Load.e bus1=n.2 phases=1 kv=7.2 kw=60 kvar=20 daily=kvar duty=home
New Load.f bus1=n.3 phases=1 kv=7.2 kw=60 kvar=20 daily=kw
New Load.g bus1=n.1 phases=1 kv=7.2 kw=60 kvar=20 daily=home status=fixed
New Load.h bus1=n.1 phases=1 kv=7.2 kw=60 kvar=20 daily=home status=exempt
New Load.i bus1=n.1 phases=1 kv=7.2 kw=60 kvar=20
New Load.j bus1=n.2 phases=1 kv=7.2 kw=60 kvar=20 daily=uneven
Load.d.daily=home
Set LoadMult=0.8
"""


def largest_difference(master, folder, mode, step_s, steps):
    """Import a script, solve it by both programs in a mode of time, and return the largest difference, p.u."""
    imported = read_opendss(master)
    ThreePhaseFeeder.from_network(imported.network).to_csv(folder)
    write_imported_profiles(imported.profiles, folder)
    feeder = ThreePhaseFeeder.from_csv(folder)
    profiles = {
        "file": folder / f"load_profiles_{mode}.csv", "columns": "class", "days": "repeat", "start_h": 0.0,
        "classes": folder / f"load_classes_{mode}.csv", "uncovered": "nominal",
    }  # fmt: skip
    at = next(bus for bus, phases in zip(feeder.bus_ids[1:], feeder.bus_phases[1:], strict=True) if len(phases) == 3)
    s = Scenario(
        name="shapes", feeder=feeder, source_voltage_pu=feeder.v0_pu, power_flow="sweep", dt_s=step_s,
        inverters={"buses": (at,), "s_rated_kva": 1e-3},
        horizon=steps - 1, load_profiles=profiles, background={"load_sigma": 0.0},
        grid_control={"regulators": "fixed"} if feeder.n_regulator else {},
    )  # fmt: skip
    ours = []
    for step in transitions(s, NoControl(), [0]):
        phases = step.state.three_phase
        ours.append(phases.v_re_pu[0] + 1j * phases.v_im_pu[0])
        if len(ours) == steps:
            break
    engine = dss.NewContext()
    engine.Text.Command(f'redirect "{master}"')
    engine.Text.Command("set controlmode=off tolerance=1e-10 maxiterations=1000")
    engine.Text.Command(f"set mode={mode} number=1 stepsize={step_s:g}s hour=0 sec=0")
    base = dict(zip(feeder.node_ids, 1000.0 * np.array(feeder.base_kv_ln)[feeder.node_bus], strict=True))
    largest = 0.0
    for k in range(1, steps):
        engine.Solution.Solve()
        assert engine.Solution.Converged()
        flat = np.array(engine.Circuit.AllBusVolts())
        theirs = dict(zip(map(str.lower, engine.Circuit.AllNodeNames()), flat[::2] + 1j * flat[1::2], strict=True))
        for i, node in enumerate(feeder.node_ids):
            bus, _, letter = node.rpartition(".")
            number = "abc".index(letter) + 1
            largest = max(largest, abs(theirs[f"{bus.lower()}.{number}"] / base[node] - ours[k][i]))
    return imported, largest


@pytest.mark.parametrize(
    ("mode", "step_s", "steps"),
    [("daily", 3600.0, 27), ("daily", 1800.0, 50), ("yearly", 3600.0, 80), ("duty", 1800.0, 30)],
)
@pytest.mark.slow
def test_voltages_over_time_are_opendss(master, tmp_path, mode, step_s, steps):
    folder = tmp_path / "feeder"
    path = master(SHAPES + LOADS)
    # OpenDSS follows the points at uneven times, which a profile does not have
    path.write_text(path.read_text().replace(" daily=uneven", ""))
    imported, largest = largest_difference(path, folder, mode, step_s, steps)
    assert largest < 1e-6
    assert {p.mode for p in imported.profiles} == {"daily", "yearly", "duty"}
    taken = [row for row in imported.findings if row.kind == "loadshape"]
    assert {row.fate for row in taken} == {"taken"}
    assert any("status is fixed" in row.text and row.names == ("g",) for row in imported.findings)


@pytest.mark.slow
def test_a_shape_that_cannot_be_a_profile_is_named(master):
    imported = read_opendss(master(SHAPES + LOADS))
    rows = {row.text: row.names for row in imported.findings}
    assert rows["its daily load shape uneven is left out: its points are at uneven times"] == ("j",)
    assert "j" not in dict(imported.profiles[0].classes)


@pytest.mark.slow
def test_a_bundled_feeder_over_a_day(tmp_path):
    text = "\n".join(script_of(load_feeder("ieee123-3ph").network))
    path = tmp_path / "Master.dss"
    path.write_text(text.replace("set voltagebases", f"{SHAPES}\nBatchEdit Load..* daily=home\nset voltagebases", 1))
    if "daily=home" not in path.read_text():
        path.write_text(text + f"\n{SHAPES}\nBatchEdit Load..* daily=home\n")
    imported, largest = largest_difference(path, tmp_path / "feeder", "daily", 3600.0, 25)
    assert largest < 1e-6
    assert len(imported.profiles[0].classes) == len(imported.network.phase_load)


@pytest.mark.slow
def test_a_public_circuit_over_a_day(tmp_path):
    folder = ROOT.parent / "shared" / "circuits" / "IEEETestCases" / "LVTestCase"
    if not folder.is_dir():
        pytest.skip("the circuits are not there")
    imported, largest = largest_difference(folder / "Master.dss", tmp_path / "feeder", "yearly", 3600.0, 25)
    assert largest < 1e-6
    assert len(imported.profiles[0].classes) == 55
