"""What tests of imports share: how far our voltages are from the source's solver, and whether two feeders are one."""

import numpy as np

from dcgrid_env import Feeder
from dcgrid_env.powerflow import distflow

FIGURES = ("p_load_kw", "r_ohm", "x_ohm", "shunt_kw", "shunt_kvar", "voltage_ratio", "bus_base_kv", "rating_a")


def apart_pu(imported) -> float:
    """Largest difference of the voltages of an import to those of the source's own solver, p.u."""
    feeder = Feeder.from_network(imported.network)
    ours = distflow(feeder, feeder.p_load_kw, feeder.q_load_kvar - feeder.capacitor_kvar)
    assert ours.converged
    assert imported.v_pu, "the source's solver found no solution"
    return max(abs(v - imported.v_pu[bus]) for bus, v in zip(feeder.bus_ids, ours.v_pu, strict=True)
               if bus in imported.v_pu)  # fmt: skip


def assert_same_feeder(one: Feeder, other: Feeder, *, rtol: float = 1e-12) -> None:
    """Buses, branches and figures agree; capacitors of constant kvar may stand as loads."""
    assert one.bus_ids == other.bus_ids
    assert (one.base_kv, one.v0_pu) == (other.base_kv, other.v0_pu)
    np.testing.assert_array_equal(one.parent, other.parent)
    drawn = [feeder.q_load_kvar - feeder.capacitor_kvar for feeder in (one, other)]
    np.testing.assert_allclose(*drawn, rtol=rtol, atol=1e-9)
    for name in FIGURES:
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None), name
        if a is not None:
            np.testing.assert_allclose(a, b, rtol=rtol, atol=1e-9 * np.nanmax(np.abs(a)), err_msg=name)


def fates(imported) -> dict[tuple[str, str], tuple[str, ...]]:
    """Names by kind and fate."""
    found: dict[tuple[str, str], tuple[str, ...]] = {}
    for row in imported.findings:
        found[row.kind, row.fate] = found.get((row.kind, row.fate), ()) + row.names
    return found
