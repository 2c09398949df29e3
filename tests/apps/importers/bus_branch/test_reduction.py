"""Buses and branches become a radial feeder: what is merged, referred, left out and refused, against a mesh solver."""

import numpy as np
import pytest

from dcgrid_env import Feeder, FeederError
from dcgrid_env.apps.importers.bus_branch import Branch, ClosedSwitch, Source, described, reduced_network
from dcgrid_env.apps.importers.bus_branch.description import empty_grid
from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.matpower.case_newton import CaseModel, solved
from dcgrid_env.powerflow import distflow
from helpers.imports import assert_same_feeder

CHOICES = r"--source a \(2 buses, 3.0 kW of load\) or --source d \(2 buses, 9.0 kW of load\)"


def grid(n=5, base_kv=20.0):
    made = empty_grid("net", 10.0, tuple("abcdefgh"[:n]), np.full(n, base_kv))
    made.sources = [Source("ext_grid", "0", 0, 1.02)]
    return made


def reduced(made, **options):
    return reduced_network(made, Report("net"), **options)


def volts(feeder):
    """Voltages of a feeder by our power flow, by bus."""
    found = distflow(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    return dict(zip(feeder.bus_ids, found.v_pu, strict=True))


def mesh_volts(made):
    """Voltages by Newton's method on the bus admittance matrix, which merges and refers nothing."""
    closed = [b for b in made.branches if b.from_closed and b.to_closed]
    assert all(b.y_from_pu == b.y_to_pu for b in closed)
    assert not any(b.y_from_pu.real for b in closed)
    model = CaseModel(
        from_row=np.array([b.from_bus for b in closed]),
        to_row=np.array([b.to_bus for b in closed]),
        z_pu=np.array([b.z_pu for b in closed]),
        charging_pu=np.array([2.0 * b.y_from_pu.imag for b in closed]),
        tap=np.array([b.tap * np.exp(1j * np.deg2rad(b.shift_deg)) for b in closed]),
        shunt_pu=(made.shunt_kw + 1j * made.shunt_kvar) / (1000.0 * made.base_mva),
        injection_pu=-(made.p_kw + 1j * made.q_kvar) / (1000.0 * made.base_mva),
        v_pu=np.full(made.n_bus, made.sources[0].v_pu),
        reference=np.arange(made.n_bus) == made.sources[0].bus,
        pv=np.zeros(made.n_bus, dtype=bool),
    )
    v, converged = solved(model)
    assert converged
    return dict(zip(made.buses, np.abs(v), strict=True))


def rich():
    """Parallel lines one of which is drawn backwards, a transformer each way round, off its ratio, charging and
    shunts."""
    made = grid(6)
    made.base_kv[3:] = 0.4
    made.p_kw[:] = [0, 900, -300, 500, 200, 100]
    made.q_kvar[:] = [0, 200, 100, 150, 20, 10]
    made.shunt_kw[4], made.shunt_kvar[2] = 20.0, 150.0
    made.branches = [
        Branch("line", "0", 0, 1, 0.02 + 0.03j, 0.01j, 0.01j, rating_pu=1.0),
        Branch("line", "1", 1, 0, 0.04 + 0.01j, 0.02j, 0.02j, rating_pu=0.2),
        Branch("line", "2", 2, 1, 0.03 + 0.02j, 0.005j, 0.005j),
        Branch("trafo", "0", 2, 3, 0.01 + 0.06j, -0.001j, -0.001j, tap=0.97, shift_deg=150.0, rating_pu=0.5),
        Branch("trafo", "1", 5, 3, 0.01 + 0.06j, -0.002j, -0.002j, tap=1.04),
        Branch("line", "3", 3, 4, 0.05 + 0.02j),
    ]
    return made


def test_voltages_are_those_of_a_solver_that_merges_and_refers_nothing():
    made = rich()
    wanted, found = mesh_volts(made), volts(Feeder.from_network(reduced(made).network))
    assert max(wanted.values()) - min(wanted.values()) > 0.05
    assert max(abs(wanted[bus] - v) for bus, v in found.items()) < 1e-8


def test_parallel_branches_carry_what_the_weaker_allows():
    feeder = Feeder.from_network(reduced(rich()).network)
    y = abs(1 / (0.02 + 0.03j) + 1 / (0.04 + 0.01j))
    limit_pu = min(1.0 * y * abs(0.02 + 0.03j), 0.2 * y * abs(0.04 + 0.01j))
    assert feeder.rating_a is not None
    assert feeder.rating_a[0] == pytest.approx(limit_pu * 10e3 / (np.sqrt(3) * 20.0))
    # A transformer's rating is of its to side, whose currents are 0.97 times as large for the source.
    assert feeder.rating_a[feeder.index("d") - 1] == pytest.approx(0.5 / 0.97 * 10e3 / (np.sqrt(3) * 20.0))


def test_closed_switches_join_buses_and_open_ends_leave_their_charging():
    made = grid()
    made.p_kw[2], made.p_kw[3] = 100.0, 50.0
    made.branches = [
        Branch("line", "0", 0, 1, 0.02 + 0.03j),
        Branch("line", "1", 2, 4, 0.5 + 0.5j, 0.1j, 0.1j, to_closed=False),
    ]
    made.switches = [ClosedSwitch("7", 1, 2), ClosedSwitch("8", 3, 2)]
    report = Report("net")
    found = reduced_network(made, report)
    feeder = Feeder.from_network(found.network)
    assert feeder.bus_ids == ("a", "b")
    assert found.bus_of == {"a": "a", "b": "b", "c": "b", "d": "b"}
    assert feeder.p_load_kw[1] == 150.0
    whole = 0.1j + 0.1j / (1 + (0.5 + 0.5j) * 0.1j)
    assert feeder.shunt_kvar is not None
    assert feeder.shunt_kvar[1] == pytest.approx(whole.imag * 10e3)
    texts = {(row.kind, row.names): row.text for row in report.findings}
    assert texts["switch", ("7", "8")] == "closed: its two buses are one"
    assert texts["bus", ("e",)] == "without supply: it is left out"


def test_a_line_beside_a_closed_switch_carries_nothing():
    made = grid(2)
    made.branches = [Branch("line", "0", 0, 1, 0.02 + 0.03j, 0.01j, 0.01j)]
    made.switches = [ClosedSwitch("7", 0, 1)]
    network = reduced(made).network
    assert len(network.line) == 0
    assert network.shunt.shunt_kvar == pytest.approx((200.0,))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda g: g.branches.append(Branch("trafo", "9", 0, 4, 0.1j, tap=1.1)), "a loop with line 1, line 0, "),
        (lambda g: g.branches.append(Branch("trafo", "9", 4, 0, 0.1j, shift_deg=30.0)), "phase shifts differ from"),
        (lambda g: g.sources.append(Source("ext_grid", "5", 4, 1.0)), "ext_grid 5: it feeds the same island"),
        (lambda g: g.branches.append(Branch("trafo", "9", 0, 1, 0.1j, tap=1.1)), "with another ratio or phase shift"),
        (lambda g: g.branches.append(Branch("trafo", "9", 0, 1, 0.1j, shift_deg=30.0)), "ratio or phase shift"),
        (lambda g: g.branches.__setitem__(1, Branch("line", "1", 1, 2, -0.1 + 0.1j)), "its series resistance is neg"),
        (lambda g: g.branches.__setitem__(1, Branch("line", "1", 1, 2, complex("nan"))), "its series impedance is nan"),
        (lambda g: g.branches.__setitem__(1, Branch("line", "1", 1, 2, 0.1j, tap=0.0)), "its ratio is 0 p.u."),
        (lambda g: g.sources.clear(), "no source in service"),
        (lambda g: g.switches.append(ClosedSwitch("3", 1, 2)) or g.base_kv.__setitem__(2, 10.0), "20 and 10 kV"),
    ],
)  # fmt: skip
def test_what_no_radial_feeder_has_is_refused_by_name(change, told):
    made = grid()
    made.branches = [Branch("line", str(k), k, k + 1, 0.1 + 0.1j) for k in range(4)]
    change(made)
    with pytest.raises(FeederError, match=r"net") as refused:
        reduced(made)
    assert told in str(refused.value)


def ring():
    """A ring over two transformers of one ratio, one of which is drawn backwards, and a chord."""
    made = grid(6)
    made.base_kv[1:3], made.base_kv[3:] = 20.0, 10.0
    made.p_kw[:], made.q_kvar[:] = [0, 400, 300, -200, 500, 300], [0, 100, -50, 100, 150, 80]
    made.shunt_kvar[4] = 200.0
    made.branches = [
        Branch("line", "0", 0, 1, 0.02 + 0.03j, 0.01j, 0.01j),
        Branch("line", "1", 2, 0, 0.03 + 0.02j, 0.005j, 0.005j),
        Branch("trafo", "0", 1, 3, 0.01 + 0.06j, -0.001j, -0.001j, tap=0.95, shift_deg=150.0),
        Branch("trafo", "1", 5, 2, 0.02 + 0.05j, tap=1 / 0.95, shift_deg=210.0, rating_pu=0.4),
        Branch("line", "2", 3, 4, 0.05 + 0.02j),
        Branch("line", "3", 5, 4, 0.03 + 0.04j, rating_pu=0.3),
        Branch("line", "4", 1, 2, 0.05 + 0.05j),
    ]
    return made


def test_voltages_of_a_ring_over_transformers():
    made, report = ring(), Report("net")
    feeder = Feeder.from_network(reduced_network(made, report).network)
    assert feeder.n_loop == 2
    wanted, found = mesh_volts(made), volts(feeder)
    assert max(wanted.values()) - min(wanted.values()) > 0.02
    assert max(abs(wanted[bus] - v) for bus, v in found.items()) < 1e-8
    texts = {row.names: row.text for row in report.findings}
    assert texts["4",] == "one branch; it closes a loop with line 0, line 1, which is solved by compensation"
    assert feeder.rating_a is not None
    # A rating of line 3 at its own 10 kV is referred to the source, like that of the other branches.
    assert feeder.rating_a[-1] == pytest.approx(0.3 * 0.95**-1 * 10e3 / (np.sqrt(3) * 20.0))


def test_one_of_several_islands_is_chosen_by_its_source():
    made = grid()
    made.branches = [Branch("line", "0", 0, 1, 0.1j), Branch("line", "1", 3, 4, 0.1j)]
    made.sources += [Source("ext_grid", "5", 3, 0.99), Source("ext_grid", "a", 3, 0.99)]
    made.p_kw[:] = [1.0, 2.0, 3.0, 4.0, 5.0]
    with pytest.raises(FeederError, match=rf"net 'net' has sources of 2 islands; choose one by {CHOICES}"):
        reduced(made)
    feeder = Feeder.from_network(reduced(made, source="d").network)
    assert (feeder.bus_ids, feeder.v0_pu) == (("d", "e"), 0.99)
    with pytest.raises(FeederError, match=rf"'c' is no source of net 'net'; choose {CHOICES}"):
        reduced(made, source="c")


def test_a_heavily_meshed_grid_is_refused_at_once():
    made = empty_grid("net", 10.0, tuple(map(str, range(3000))), np.full(3000, 20.0))
    made.sources = [Source("ext_grid", "0", 0, 1.0)]
    made.branches = [Branch("line", f"{k}-{j}", k, j, 0.1j) for k in range(2900) for j in (k + 1, k + 50)]
    with pytest.raises(FeederError, match="it closes a loop as well") as refused:
        reduced(made)
    assert len(str(refused.value)) < 5000


def test_a_chain_of_many_buses_does_not_recurse():
    n = 20000
    made = empty_grid("net", 10.0, tuple(map(str, range(n))), np.full(n, 20.0))
    made.sources = [Source("ext_grid", "0", 0, 1.0)]
    made.branches = [Branch("line", str(k), k, k + 1, 1e-6j) for k in range(n - 1) if k % 2]
    made.switches = [ClosedSwitch(str(k), k, k + 1) for k in range(0, n - 1, 2)]
    assert len(reduced(made).network.node) == n // 2


def test_a_feeder_described_and_reduced_is_itself():
    feeder = Feeder.from_network(reduced(rich()).network)
    again = Feeder.from_network(reduced(described(feeder, 7.0)).network)
    assert_same_feeder(feeder, again)
