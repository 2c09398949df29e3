"""A balanced feeder in other power-flow libraries, to check figures and speed against.

Each function here takes a :class:`~dcgrid_env.Feeder` and the substation voltage and returns a
:class:`ReferenceSolver`. The libraries come with the extra ``bench`` and are imported in the function that needs them,
no sooner.

A branch without impedance (a closed switch) is a bus-bus switch in pandapower, which fuses its two buses, and a link of
1e6 p.u. or more in power-grid-model. lightsim2grid and OpenDSS get a reactance of ``SWITCH_X_PU`` instead: 3 Mvar
through it lose 3e-7 p.u. of voltage.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.core.threads import n_threads
from dcgrid_env.grid import Feeder
from dcgrid_env.grid.per_unit import impedance_base_ohm

FloatArray = NDArray[np.float64]
Solve = Callable[[FloatArray, FloatArray], FloatArray]

SWITCH_X_PU = 1e-7
"""Reactance of a closed switch, p.u. on 1 MVA, where a library has none: small, yet the matrix still inverts well."""
TOLERANCE_PU = 1e-8
"""Tolerance of each library, p.u. of power on 1 MVA or of voltage, whichever the library uses."""


@dataclass(frozen=True)
class ReferenceSolver:
    """A feeder set up in another library.

    Attributes
    ----------
    name
        Library and, where there is a choice, how it is called.
    solve
        From loads p_kw, q_kvar, shape (n_bus,), consumption positive, to voltage magnitudes in p.u., shape (n_bus,), in
        the order of ``feeder.bus_ids``. RuntimeError, or the library's own error, where it finds no solution.
    solve_batch
        From loads of shape (row, n_bus), a row for each feeder, to voltages of that shape in one call of the library;
        None where it has no such call.
    """

    name: str
    solve: Solve
    solve_batch: Solve | None = None


def pandapower_defaults(feeder: Feeder, v0_pu: float | None = None) -> ReferenceSolver:
    """pandapower as it comes: ``runpp(net)``, which borrows lightsim2grid's Newton where that is installed."""
    return _pandapower("pandapower, runpp(net)", feeder, v0_pu)


def pandapower_numba(feeder: Feeder, v0_pu: float | None = None) -> ReferenceSolver:
    """pandapower's own Newton with numba."""
    return _pandapower("pandapower, runpp(net, numba=True), its own Newton", feeder, v0_pu, **_NUMBA)


def pandapower_recycled(feeder: Feeder, v0_pu: float | None = None) -> ReferenceSolver:
    """pandapower's own Newton with numba, everything but the loads kept from call to call: its quickest."""
    options = {**_NUMBA, "recycle": {"bus_pq": True, "trafo": False, "gen": False}}
    return _pandapower("pandapower, the same with recycle", feeder, v0_pu, **options)


_NUMBA: dict[str, Any] = {"numba": True, "lightsim2grid": False}


def _pandapower(name: str, feeder: Feeder, v0_pu: float | None, **options: Any) -> ReferenceSolver:
    import pandapower as pp

    net = pp.create_empty_network(sn_mva=1.0)
    pp.create_buses(net, feeder.n_bus, vn_kv=feeder.base_kv)
    pp.create_ext_grid(net, 0, vm_pu=_substation(feeder, v0_pu))
    switch, to_bus = _switches(feeder), np.arange(1, feeder.n_bus)
    _pandapower_lines(net, feeder.parent[~switch], to_bus[~switch], feeder.r_ohm[~switch], feeder.x_ohm[~switch])
    for i, j in zip(feeder.parent[switch].tolist(), to_bus[switch].tolist(), strict=True):
        pp.create_switch(net, i, j, et="b", closed=True)
    pp.create_loads(net, list(range(feeder.n_bus)), p_mw=0.0, q_mvar=0.0)

    def solve(p_kw: FloatArray, q_kvar: FloatArray) -> FloatArray:
        net.load["p_mw"] = p_kw / 1e3
        net.load["q_mvar"] = q_kvar / 1e3
        pp.runpp(net, tolerance_mva=TOLERANCE_PU, **options)
        return net.res_bus.vm_pu.to_numpy(copy=True)

    return ReferenceSolver(name, solve)


def _pandapower_lines(net: Any, from_bus: Any, to_bus: Any, r_ohm: FloatArray, x_ohm: FloatArray) -> None:
    import pandapower as pp

    impedance = {"r_ohm_per_km": r_ohm, "x_ohm_per_km": x_ohm, "c_nf_per_km": 0.0, "max_i_ka": 1.0}
    pp.create_lines_from_parameters(net, from_bus, to_bus, length_km=1.0, **impedance)


def power_grid_model(feeder: Feeder, v0_pu: float | None = None) -> ReferenceSolver:
    """power-grid-model by iterative current injection: exact, and on a radial feeder its quickest such method.

    The batch runs on ``n_threads()`` threads. The source's short-circuit power of 1e18 VA leaves no drop behind it.
    """
    import power_grid_model as pgm  # pyright: ignore[reportMissingImports]  (in the bench extra only)

    n = feeder.n_bus
    loads = _table(pgm, "input", "sym_load", np.arange(2 * n, 3 * n), node=np.arange(n), status=1)
    loads["type"] = pgm.LoadGenType.const_power
    loads["p_specified"] = loads["q_specified"] = 0.0
    model = pgm.PowerGridModel({**_pgm_network(pgm, feeder, _substation(feeder, v0_pu)), "sym_load": loads})
    options: dict[str, Any] = {
        "error_tolerance": TOLERANCE_PU,
        "max_iterations": 100,
        "calculation_method": pgm.CalculationMethod.iterative_current,
        "output_component_types": ["node"],
    }

    def update(p_kw: FloatArray, q_kvar: FloatArray) -> dict[str, Any]:
        table = pgm.initialize_array("update", "sym_load", p_kw.shape)
        table["id"], table["p_specified"], table["q_specified"] = loads["id"], p_kw * 1e3, q_kvar * 1e3
        return {"sym_load": table}

    def solve(p_kw: FloatArray, q_kvar: FloatArray) -> FloatArray:
        model.update(update_data=update(p_kw, q_kvar))
        return model.calculate_power_flow(**options)["node"]["u_pu"]

    def solve_batch(p_kw: FloatArray, q_kvar: FloatArray) -> FloatArray:
        data = update(p_kw, q_kvar)
        return model.calculate_power_flow(update_data=data, threading=n_threads(), **options)["node"]["u_pu"]

    return ReferenceSolver("power-grid-model, iterative current", solve, solve_batch)


def _pgm_network(pgm: Any, feeder: Feeder, v0_pu: float) -> dict[str, Any]:
    """Everything but the loads: nodes 0 .. n - 1, branches n .. 2 n - 2 by their receiving bus, the source 3 n."""
    n, switch = feeder.n_bus, _switches(feeder)
    ids, to_bus = np.arange(n, 2 * n - 1), np.arange(1, n)

    def branches(kind: str, which: Any, **more: Any) -> Any:
        ends = {"from_node": feeder.parent[which], "to_node": to_bus[which], "from_status": 1, "to_status": 1}
        return _table(pgm, "input", kind, ids[which], **ends, **more)

    z = {"r1": feeder.r_ohm[~switch], "x1": feeder.x_ohm[~switch], "c1": 0.0, "tan1": 0.0, "i_n": 1e3}
    return {
        "node": _table(pgm, "input", "node", np.arange(n), u_rated=feeder.base_kv * 1e3),
        "line": branches("line", ~switch, **z),
        "link": branches("link", switch),
        "source": _table(pgm, "input", "source", np.array([3 * n]), node=0, status=1, u_ref=v0_pu, sk=1e18),
    }


def _table(pgm: Any, dataset: str, kind: str, ids: Any, **columns: Any) -> Any:
    table = pgm.initialize_array(dataset, kind, len(ids))
    table["id"] = ids
    for name, values in columns.items():
        table[name] = values
    return table


def lightsim2grid(feeder: Feeder, v0_pu: float | None = None) -> ReferenceSolver:
    """lightsim2grid: Newton with KLU, from a flat start; the batch on ``n_threads()`` threads.

    A single solve sets the loads by its vectorised call, which takes them in float32 (some 1e-8 p.u. of voltage).
    """
    import pandapower as pp
    from lightsim2grid.injectionSweep import InjectionSweepCPP  # pyright: ignore[reportMissingImports]  (bench only)
    from lightsim2grid.network import init_from_pandapower  # pyright: ignore[reportMissingImports]  (bench only)

    n, v0 = feeder.n_bus, _substation(feeder, v0_pu)
    net = pp.create_empty_network(sn_mva=1.0)
    pp.create_buses(net, n, vn_kv=feeder.base_kv)
    pp.create_gen(net, 0, p_mw=0.0, vm_pu=v0, slack=True, slack_weight=1.0)
    _pandapower_lines(net, feeder.parent, np.arange(1, n), feeder.r_ohm, _x_ohm(feeder))
    pp.create_loads(net, list(range(n)), p_mw=0.0, q_mvar=0.0)
    grid = init_from_pandapower(net)
    every, flat = np.ones(n, dtype=bool), np.full(n, v0, dtype=np.complex128)
    sweep = InjectionSweepCPP(grid)
    sweep.nb_thread = n_threads()

    def solve(p_kw: FloatArray, q_kvar: FloatArray) -> FloatArray:
        grid.update_loads_p(every, (p_kw / 1e3).astype(np.float32))
        grid.update_loads_q(every, (q_kvar / 1e3).astype(np.float32))
        v_pu = np.abs(grid.ac_pf(flat, 20, TOLERANCE_PU))
        if not len(v_pu):
            raise RuntimeError(f"lightsim2grid found no power flow on feeder {feeder.name!r}")
        return v_pu

    def solve_batch(p_kw: FloatArray, q_kvar: FloatArray) -> FloatArray:
        sweep.clear()  # it holds on to the first batch's number of rows
        sweep.modify_load_p(p_kw / 1e3)
        sweep.modify_load_q(q_kvar / 1e3)
        sweep.compute(flat, 20, TOLERANCE_PU)
        if not all(sweep.converged_mask()):
            raise RuntimeError(f"lightsim2grid found no power flow in a row of feeder {feeder.name!r}")
        return np.abs(sweep.get_voltages())

    return ReferenceSolver("lightsim2grid, Newton", solve, solve_batch)


def opendss(feeder: Feeder, v0_pu: float | None = None) -> ReferenceSolver:
    """Return OpenDSS (dss_capi) in a separate engine context, with a circuit of three equal, uncoupled phases.

    A solve starts from the one before it, as OpenDSS does; more than half of its time goes into setting the loads, one
    by one through Python. The source's short-circuit power is 1e12 MVA.
    """
    import opendssdirect  # pyright: ignore[reportMissingImports]  (in the bench extra only)

    dss: Any = opendssdirect.NewContext()
    for command in _dss_commands(feeder, _substation(feeder, v0_pu)):
        dss.Text.Command(command)
    names = list(dss.Circuit.AllNodeNames())
    first_class = np.array([names.index(f"b{i}.1") for i in range(feeder.n_bus)])
    loads = dss.Loads

    def solve(p_kw: FloatArray, q_kvar: FloatArray) -> FloatArray:
        loads.First()
        for p, q in zip(p_kw.tolist(), q_kvar.tolist(), strict=True):
            loads.kW(p)
            loads.kvar(q)
            loads.Next()
        dss.Solution.Solve()
        if not dss.Solution.Converged():
            raise RuntimeError(f"OpenDSS found no power flow on feeder {feeder.name!r}")
        return np.asarray(dss.Circuit.AllBusMagPu())[first_class]

    return ReferenceSolver("OpenDSS by OpenDSSDirect.py", solve)


def _dss_commands(feeder: Feeder, v0_pu: float) -> list[str]:
    """The circuit as OpenDSS text: buses b0 .. and, in the order of the buses, one load at each."""
    kv = feeder.base_kv
    branches = zip(feeder.parent.tolist(), feeder.r_ohm.tolist(), _x_ohm(feeder).tolist(), strict=True)
    lines = [
        f"New Line.l{j} phases=3 bus1=b{i} bus2=b{j} length=1 r1={r!r} x1={x!r} r0={r!r} x0={x!r} c1=0 c0=0"
        for j, (i, r, x) in enumerate(branches, start=1)
    ]
    loads = [
        f"New Load.d{i} phases=3 conn=wye model=1 bus1=b{i} kv={kv!r} kw=0 kvar=0 vminpu=0.5 vmaxpu=1.5"
        for i in range(feeder.n_bus)
    ]
    return [
        "Clear",
        f"New Circuit.feeder phases=3 bus1=b0 basekv={kv!r} pu={v0_pu!r} MVAsc3=1e12 MVAsc1=1e12",
        *lines,
        *loads,
        f"Set voltagebases=[{kv!r}]",
        "Calcvoltagebases",
        f"Set mode=snapshot controlmode=off maxiterations=100 tolerance={TOLERANCE_PU:g}",
    ]


def _substation(feeder: Feeder, v0_pu: float | None) -> float:
    return feeder.v0_pu if v0_pu is None else float(v0_pu)


def _switches(feeder: Feeder) -> NDArray[np.bool_]:
    """Which branches have no impedance, shape (n_bus - 1,)."""
    return (feeder.r_ohm == 0.0) & (feeder.x_ohm == 0.0)


def _x_ohm(feeder: Feeder) -> FloatArray:
    """Reactance of each branch, ohm, with ``SWITCH_X_PU`` in place of none at all."""
    return np.where(_switches(feeder), SWITCH_X_PU * impedance_base_ohm(feeder.base_kv), feeder.x_ohm)


Build = Callable[[Feeder, float | None], ReferenceSolver]
REFERENCE_SOLVERS: dict[str, tuple[Build, tuple[str, ...]]] = {
    "pandapower, defaults": (pandapower_defaults, ("pandapower",)),
    "pandapower, numba": (pandapower_numba, ("pandapower",)),
    "pandapower, recycled": (pandapower_recycled, ("pandapower",)),
    "power-grid-model": (power_grid_model, ("power_grid_model",)),
    "lightsim2grid": (lightsim2grid, ("lightsim2grid", "pandapower")),
    "OpenDSS": (opendss, ("opendssdirect",)),
}
"""Each solver's function and the modules that it imports."""


def missing(name: str) -> list[str]:
    """Modules that the reference solver of this name needs and that are not installed."""
    return [module for module in REFERENCE_SOLVERS[name][1] if find_spec(module) is None]
