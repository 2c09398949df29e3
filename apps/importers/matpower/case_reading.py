"""Read a balanced feeder from a MATPOWER case file (version 2), which is never executed."""

from __future__ import annotations

import math
from collections.abc import Collection
from pathlib import Path

import numpy as np

from dcgrid_env.apps.importers.bus_branch import Branch, BusBranchGrid, ImportedFeeder, Source, imported
from dcgrid_env.apps.importers.bus_branch.bus_naming import errors_naming, named_buses
from dcgrid_env.apps.importers.bus_branch.description import empty_grid
from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.matpower.case_checks import check_case
from dcgrid_env.apps.importers.matpower.case_newton import CaseModel, admittance, solved
from dcgrid_env.apps.importers.matpower.case_tables import CaseTables, case_tables, case_text
from dcgrid_env.grid.topology import FeederError

_PQ, _PV, _REFERENCE, _ISOLATED = 1, 2, 3, 4
SOLVER = "MATPOWER's power flow (Newton's method on its tables, as this package does it)"


def read_matpower(
    path: str | Path,
    *,
    source: str | None = None,
    allow: Collection[str] = (),
    per_phase: bool = False,
    fix_generators: bool = False,
    bus_names: bool = False,
) -> ImportedFeeder:
    """Read a case; nothing beyond the base installation is needed.

    Parameters
    ----------
    path
        The ``.m`` file.
    source
        Reference bus whose island is taken, where there are several.
    allow
        Kinds of elements that may be left out although something is lost.
    per_phase
        Its powers and ``baseMVA`` are of one phase and are multiplied by three; its base voltages are from line to
        neutral and are multiplied by sqrt(3).
    fix_generators
        Generators that keep a voltage become constant loads, of the power that MATPOWER's power flow gives them.
    bus_names
        Call buses by ``mpc.bus_name`` rather than by their numbers.

    Raises
    ------
    FeederError
        For code that is not read, figures that cannot be used, naming file, line, table, row and column, and for
        what cannot be represented, naming it.
    """
    path = Path(path)
    with errors_naming(path):
        text, report = case_text(path), Report("case")
        case = case_tables(str(path), text, report)
        check_case(str(path), case)
        if per_phase:
            case.base_mva *= 3.0
            for table, columns in (("bus", [2, 3, 4, 5]), ("gen", [1, 2]), ("branch", [5, 6, 7])):
                case.tables[table][:, columns] *= 3.0
            case.tables["bus"][:, 9] *= math.sqrt(3.0)
            report.add("taken", "case", case.name, "one phase: powers times three, base voltages times sqrt(3)")
        rows = {int(number): i for i, number in enumerate(case.tables["bus"][:, 0])}
        model = _model(str(path), case, rows)
        grid = _grid(case, rows, named_buses(str(path), _names(case, bus_names)))
        _sources_and_generators(grid, case, rows, report, _drawn_kva(model, case) if fix_generators else None)
        notes = ()
        if not per_phase and says_single_phase(text):
            notes = (
                "the file speaks of single-phase MW: --per-phase multiplies its powers by three and its base voltages "
                "by sqrt(3)",
            )

        def voltages() -> dict[str, float]:
            v, converged = solved(model)
            return dict(zip(grid.buses, np.abs(v).tolist(), strict=True)) if converged else {}

        facts = f"MATPOWER case {case.name}"
        return imported(
            grid, report, voltages, solver=SOLVER, source=source, allow=allow, source_of_facts=facts, notes=notes
        )


def _drawn_kva(model: CaseModel, case: CaseTables) -> np.ndarray:
    """Power drawn at each bus in MATPOWER's solution, kVA; FeederError where it finds none."""
    v, converged = solved(model)
    if not converged:
        raise FeederError(
            f"case {case.name!r}: MATPOWER's power flow finds no solution, at which generators could be fixed"
        )
    return -1000.0 * case.base_mva * v * np.conj(admittance(model) @ v)


def says_single_phase(text: str) -> bool:
    """Whether a file's comments say that its powers are of one phase."""
    return "single-phase MW" in text


def _names(case: CaseTables, bus_names: bool) -> list[str]:
    if not bus_names:
        return [str(int(number)) for number in case.tables["bus"][:, 0]]
    if len(case.bus_names) != len(case.tables["bus"]):
        raise FeederError(f"case {case.name!r} has {len(case.bus_names)} bus names for {len(case.tables['bus'])} buses")
    return list(case.bus_names)


def _live_branches(case: CaseTables, rows: dict[int, int]) -> np.ndarray:
    """Which branches are in service between buses that are, shape (n_branch,)."""
    bus, branch = case.tables["bus"], case.tables["branch"]
    dead = bus[:, 1] == _ISOLATED
    ends = np.array([[rows[int(a)], rows[int(b)]] for a, b in branch[:, :2]], dtype=np.intp).reshape(-1, 2)
    return (branch[:, 10] == 1) & ~dead[ends].any(axis=1)


def _model(file: str, case: CaseTables, rows: dict[int, int]) -> CaseModel:
    bus, gen = case.tables["bus"], case.tables["gen"]
    branch = case.tables["branch"][_live_branches(case, rows)]
    for number, b in enumerate(branch, 1):
        if b[2] == 0 and b[3] == 0:
            raise FeederError(
                f"{file}: mpc.branch {b[0]:g}-{b[1]:g} (live branch {number}): r and x are 0, with which it has "
                "no power flow; give a small x or make its buses one"
            )
    tap = np.where(branch[:, 8] == 0, 1.0, branch[:, 8]) * np.exp(1j * np.deg2rad(branch[:, 9]))
    injection = -(bus[:, 2] + 1j * bus[:, 3])
    size, running = np.ones(len(bus)), np.zeros(len(bus), dtype=bool)
    for row in gen[gen[:, 7] > 0]:
        i = rows[int(row[0])]
        injection[i] += row[1] + 1j * row[2]
        size[i], running[i] = row[5], True
    return CaseModel(
        from_row=np.array([rows[int(b)] for b in branch[:, 0]], dtype=np.intp),
        to_row=np.array([rows[int(b)] for b in branch[:, 1]], dtype=np.intp),
        z_pu=branch[:, 2] + 1j * branch[:, 3],
        charging_pu=branch[:, 4],
        tap=tap,
        shunt_pu=(bus[:, 4] + 1j * bus[:, 5]) / case.base_mva,
        injection_pu=injection / case.base_mva,
        v_pu=size,
        reference=bus[:, 1] == _REFERENCE,
        pv=(bus[:, 1] == _PV) & running,
    )


def _grid(case: CaseTables, rows: dict[int, int], buses: tuple[str, ...]) -> BusBranchGrid:
    bus, branch = case.tables["bus"], case.tables["branch"]
    grid = empty_grid(case.name, case.base_mva, buses, bus[:, 9])
    grid.p_kw, grid.q_kvar = 1000.0 * bus[:, 2], 1000.0 * bus[:, 3]
    grid.shunt_kw, grid.shunt_kvar = 1000.0 * bus[:, 4], 1000.0 * bus[:, 5]
    live = _live_branches(case, rows)
    for b, closed in zip(branch.tolist(), live.tolist(), strict=True):
        i, j = rows[int(b[0])], rows[int(b[1])]
        transformer = b[8] != 0 or bus[i, 9] != bus[j, 9]
        charging = 0.5j * b[4]
        grid.branches.append(
            Branch(
                "transformer" if transformer else "line",
                f"{int(b[0])}-{int(b[1])}",
                i,
                j,
                complex(b[2], b[3]),
                charging,
                charging,
                b[8] or 1.0,
                b[9],
                b[5] / case.base_mva if b[5] > 0 else math.nan,
                closed,
                closed,
            )
        )
    return grid


def _sources_and_generators(
    grid: BusBranchGrid, case: CaseTables, rows: dict[int, int], report: Report, fixed: np.ndarray | None
) -> None:
    """Put sources and generators into the grid; ``fixed`` is the power drawn at each bus, kVA, if those are to keep
    it."""
    bus = case.tables["bus"]
    running: dict[int, list[np.ndarray]] = {}
    for row in case.tables["gen"]:
        if row[7] > 0:
            running.setdefault(rows[int(row[0])], []).append(row)
        else:
            report.add("nothing lost", "gen", f"at bus {row[0]:g}", "out of service: it is left out")
    report.add_all("taken", "bus", [f"{b[0]:g}" for b in bus if b[2] or b[3]], "its load, of constant power")
    report.add_all("taken", "bus", [f"{b[0]:g}" for b in bus if b[4] or b[5]], "its shunt, of constant admittance")
    for i, units in running.items():
        name, kind = f"{bus[i, 0]:g}", int(bus[i, 1])
        if kind == _REFERENCE:
            kept = {float(unit[5]) for unit in units}
            if len(kept) > 1:
                raise FeederError(
                    f"case {case.name!r}: generators at bus {name} keep different voltages, {sorted(kept)}"
                )
            grid.sources.append(Source("gen", name, i, kept.pop()))
        elif kind == _PQ:
            grid.p_kw[i] -= 1000.0 * sum(float(unit[1]) for unit in units)
            grid.q_kvar[i] -= 1000.0 * sum(float(unit[2]) for unit in units)
            report.add("taken", "gen", f"at bus {name}", "a negative load, of constant power")
        elif kind == _PV and fixed is not None:
            grid.p_kw[i], grid.q_kvar[i] = float(fixed[i].real), float(fixed[i].imag)
            report.add(
                "taken", "gen", f"at bus {name}", "a negative load, of the power that MATPOWER's power flow gives it"
            )
        elif kind == _PV:
            text = "it keeps a voltage, which no load does: --fix-generators makes it a constant power"
            report.add("refused", "gen", f"at bus {name}", text)
    for i in np.flatnonzero(bus[:, 1] == _REFERENCE).tolist():
        if i not in running:
            raise FeederError(
                f"case {case.name!r}: reference bus {bus[i, 0]:g} has no generator in service; put one there"
            )
    for row in case.tables.get("dcline", []):
        fate = "refused" if row[2] > 0 else "nothing lost"
        report.add(
            fate, "dcline", f"{row[0]:g}-{row[1]:g}", "a DC line" if row[2] > 0 else "out of service: it is left out"
        )
