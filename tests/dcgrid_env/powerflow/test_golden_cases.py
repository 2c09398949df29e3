"""Golden cases: every folder of tests/cases, with its origin, expected figures and tolerance, solved each way."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dcgrid_env import Feeder, Solution, distflow, load_feeder

CASES = Path(__file__).resolve().parents[2] / "cases"
NAMES = sorted(path.parent.name for path in CASES.glob("*/case.toml"))
KEYS = {"title", "origin", "feeder", "tables", "v0_pu", "expected", "tolerance", "maximum"}


def read(name: str) -> tuple[dict[str, Any], Feeder]:
    case = tomllib.loads((CASES / name / "case.toml").read_text(encoding="utf-8"))
    feeder = load_feeder(case["feeder"]) if "feeder" in case else Feeder.from_csv(CASES / name / case["tables"])
    return case, feeder


@pytest.fixture(params=["numpy", "torch", "arrays"])
def solve(request: pytest.FixtureRequest, as_torch: Any, as_numpy: Any, by_arrays: Any) -> Callable[..., Solution]:
    """NumPy arrays by the compiled kernels, tensors by them, tensors by array operations."""
    if request.param == "numpy":
        return distflow
    if request.param == "arrays":
        by_arrays()
    return lambda feeder, p_kw, q_kvar, v0_pu: as_numpy(distflow(feeder, *as_torch(p_kw, q_kvar), v0_pu=v0_pu))


def figures(feeder: Feeder, solution: Solution, p_kw: Any, q_kvar: Any) -> dict[str, Any]:
    """Everything that a case may expect, under the names that it uses there."""
    first = feeder.parent == 0
    by_bus = dict(zip(map(str, feeder.bus_ids), solution.v_pu.tolist(), strict=True))
    fed = [str(bus) for bus in feeder.bus_ids[1:]]
    return {
        "v_pu": by_bus,
        "lowest_v_pu": min(by_bus.values()),
        "lowest_v_bus": min(by_bus, key=lambda bus: by_bus[bus]),
        "loss_kw": float(solution.loss_kw),
        "p_import_kw": float(solution.p_branch_kw[first].sum() + p_kw[0]),
        "q_import_kvar": float(solution.q_branch_kvar[first].sum() + q_kvar[0]),
        "p_branch_kw": dict(zip(fed, solution.p_branch_kw.tolist(), strict=True)),
        "q_branch_kvar": dict(zip(fed, solution.q_branch_kvar.tolist(), strict=True)),
        "current_sq_pu": dict(zip(fed, solution.current_sq_pu.tolist(), strict=True)),
    }


def test_the_cases_are_there():
    assert {"ieee33", "das69", "two_bus", "two_bus_reverse", "two_bus_maximum", "five_bus_switch"} <= set(NAMES)
    assert {path.name for path in CASES.iterdir() if path.is_dir() and any(path.iterdir())} == set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_golden_case(name, solve):
    case, feeder = read(name)
    assert set(case) <= KEYS
    assert len(case["title"]) > 10
    assert len(case["origin"]) > 40
    solution = solve(feeder, feeder.p_load_kw, feeder.q_load_kvar, case["v0_pu"])
    assert solution.converged
    found = figures(feeder, solution, feeder.p_load_kw, feeder.q_load_kvar)
    tolerance = case["tolerance"]
    assert case["expected"]
    for key, expected in case["expected"].items():
        if key.endswith("_bus"):
            assert found[key] == str(expected)
            continue
        kind_of_figure = "power_kw" if key.endswith(("_kw", "_kvar")) else key.removeprefix("lowest_")
        within = tolerance[kind_of_figure]
        if isinstance(expected, dict):
            found[key] = {bus: found[key][bus] for bus in expected}
        assert found[key] == pytest.approx(expected, rel=0.0, abs=within), key


def test_two_buses_up_to_the_largest_load_and_beyond(solve):
    case, feeder = read("two_bus_maximum")
    maximum = case["maximum"]
    for f in maximum["fractions_with_a_solution"]:
        load = np.array([0.0, f * maximum["p_kw"]])
        solution = solve(feeder, load, 0.0 * load, 1.0)
        v_pu = math.sqrt((1.0 - 0.375 * f + math.sqrt((1.0 - f) * (1.0 + 0.25 * f))) / 2.0)
        assert solution.converged, f
        assert solution.v_pu[1] == pytest.approx(v_pu, rel=0.0, abs=case["tolerance"]["v_pu"]), f
        # l = (p^2 + q^2) / u at the receiving end, and r is 0.06 p.u.
        assert solution.loss_kw == pytest.approx(60.0 * (load[1] / 1000.0 / v_pu) ** 2, rel=1e-5), f
    for f in maximum["fractions_without"]:
        load = np.array([0.0, f * maximum["p_kw"]])
        solution = solve(feeder, load, 0.0 * load, 1.0)
        assert not solution.converged, f
        assert solution.residual_kva > 1e-4, f
