"""One compiled pass over the environments of a batch on a balanced feeder, instead of one pass for each part.

The pass draws an environment's loads, adds its agents' powers, solves its power flow and sums up its voltages while
they are in the processor's cache. Environments are distributed over threads once a step. Each part is also used alone
(``core.random.load_step``, ``powerflow.balanced.distflow_kernels``, ``voltage_figures``), with the same bits.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.compiled import compiled
from dcgrid_env.core.coverage import Coverage
from dcgrid_env.core.random import load_step
from dcgrid_env.core.threads import over_rows
from dcgrid_env.devices.capacitor_bank.capacitor_control import CapacitorControl
from dcgrid_env.devices.tap_changer.regulator_control import RegulatorControl
from dcgrid_env.engine.physics.loads import load_noise
from dcgrid_env.engine.physics.state import Exogenous, GridStep, LoadsToDraw, VoltageFigures
from dcgrid_env.engine.physics.step_kernels import add_powers, net_loads
from dcgrid_env.engine.physics.voltage_figures import fill_figures
from dcgrid_env.grid import Feeder
from dcgrid_env.grid.covered_fields import BALANCED
from dcgrid_env.grid.per_unit import S_BASE_KVA
from dcgrid_env.powerflow import has_ratings
from dcgrid_env.powerflow.balanced.batch import constants, rows
from dcgrid_env.powerflow.balanced.compiled_blocks import FEW, MOST_IN_BLOCKS, distflow_blocks
from dcgrid_env.powerflow.balanced.distflow import MAX_SWEEPS, TOLERANCE_KVA
from dcgrid_env.powerflow.balanced.distflow_kernels import distflow_rows
from dcgrid_env.powerflow.solution import raise_not_finite
from dcgrid_env.scenario.cost import Cost
from dcgrid_env.scenario.grid_control import GridControl
from dcgrid_env.scenario.grid_request import GridRequest
from dcgrid_env.scenario.load_profiles import LoadProfiles
from dcgrid_env.scenario.scenario import Scenario
from dcgrid_env.scenario.sensing import Sensing
from dcgrid_env.scenario.workload import Background, Workload

CHUNK = 64  # rows whose loads stand in the cache together
TOLERANCE = TOLERANCE_KVA[8] / S_BASE_KVA
COVERED = Coverage(
    {
        Scenario: """
            name feeder* source_voltage_pu devices* workload background sensing cost grid_control grid_request
            load_profiles sags* horizon dt_s split
        """,
        Workload: "trace* trace_scale recording_split window site_correlation compute_share full_load_s",
        Background: "capacitors load_sigma load_rho start_hour",
        Sensing: """
            noise_pu delay_steps observe preview loading regulator regulator_delay_s r_model_share x_model_share
            model_open* model_closed*
        """,
        Cost: """
            weights* band_pu voltage reference profile_pu* profile_band_pu reward default_action default_gains
            ramp_limit_kw_per_s ramp_window_s voltage_step_limit_pu
        """,
        GridControl: "regulators* capacitors* capacitor_settings regulator_settings",
        RegulatorControl: "timer offset_v* hold_s",
        CapacitorControl: "measures on_below_pu off_above_pu on_above_share off_below_share delay_s hold_s",
        GridRequest: "targets* notice_s tolerance_share",
        LoadProfiles: "",
        Feeder: BALANCED[Feeder].replace("loop_ends", ""),
    },
    arrays={
        Exogenous: """
            p_load_kw q_load_kvar p_ref_kw p_inverter_kw nodes compute_share available legs capacitor_on sags
            trip_widths to_draw offset_v request
        """,
        LoadsToDraw: "key step noise share p_kw q_kvar",
    },
)
"""What a pass covers. Devices of any class act on the grid by their powers, unless they change the grid itself."""


class GridPass(NamedTuple):
    """The power flow of a pass; the fields mean the same as those of ``Solution``."""

    v_pu: np.ndarray
    restart: np.ndarray
    loss_kw: np.ndarray
    converged: np.ndarray


@cached_on_owner
def fits(scenario: Scenario) -> bool:
    """Whether a pass does all that a step asks of the grid: radial DistFlow, loads without profiles, no faults, no
    ratings, and nothing that changes the grid."""
    feeder = scenario.feeder
    changed = any(device.changes_grid for device in scenario.devices)
    return type(feeder) is Feeder and COVERED.includes(scenario, feeder) and not has_ratings(feeder) and not changed


def grid_pass(
    scenario: Scenario, drawing: LoadsToDraw, nodes: Array, p_kw: Array, q_kvar: Array, restart: np.ndarray | None
) -> GridStep:
    """Draw the loads of an interval and solve the grid under the agents' powers, kW and kvar, (row, n_agent).

    ``nodes`` are those of ``Exogenous``. The power flow starts from ``restart``, or without current. PowerFlowError
    for a power that is not finite.
    """
    n_row, n = drawing.noise.shape
    agents = (n_row, p_kw.shape[1])
    start = np.zeros((n_row, n - 1)) if restart is None else rows(restart, (n_row, n - 1))
    of_agents = (rows(p_kw, agents), rows(q_kvar, agents), start)
    drawing_and_loads = (*drawing[:4], *load_noise(scenario))
    arguments = (*_fixed(scenario), *drawing_and_loads, nodes, *of_agents)
    over_buses, after = np.empty((4 if n_row <= FEW else 2, n_row, n)), np.empty((n_row, n - 1))
    per_row, converged = np.empty((7, n_row)), np.empty(n_row, np.bool_)
    out = (over_buses, after, per_row, converged)
    if n_row <= FEW:
        failed = _few_rows(0, n_row, *arguments, *out, np.zeros(n_row, np.int64))
    else:
        failed = over_rows(lambda first, last: _many_rows(first, last, *arguments, *out), n_row)
    if failed and not np.isfinite(p_kw + q_kvar).all():
        loads = np.empty((3, n_row, n))
        load_step(*drawing_and_loads, *loads)
        raise_not_finite(scenario.feeder, *net_loads(loads[1], loads[2], nodes, *of_agents[:2]))
    figures = VoltageFigures(per_row[0], per_row[1], per_row[2], per_row[3])
    return GridStep(GridPass(over_buses[1], after, per_row[4], converged), over_buses[0], figures)


@cached_on_owner
def _fixed(scenario: Scenario) -> tuple[Any, ...]:
    """Return the constants of the scenario for a pass, in the form that the kernel takes."""
    feeder = scenario.feeder
    judged, source_pu, band_pu = (
        feeder.load_slice.start,
        float(scenario.source_voltage_pu),
        float(scenario.cost.band_pu),
    )
    return (*constants(feeder, np.float64), source_pu, TOLERANCE, MAX_SWEEPS, judged, band_pu)


@compiled(inner=True)
def _draw(
    a, b, key, step, noise, share, rho, sigma, p_base, q_base, q_fixed, nodes, p_agent, q_agent, noise_out, p, q,
):  # fmt: skip
    """Draw the loads of the environments from ``a`` up to ``b`` into p and q, and add the agents' powers."""
    load_step(
        key[a:b], step[a:b], noise[a:b], share[a:b], rho, sigma, p_base, q_base, q_fixed, noise_out[a:b], p, q,
    )  # fmt: skip
    add_powers(p, q, nodes, p_agent, q_agent, a, b)


@compiled(nogil=True)
def _few_rows(
    first, last, order, parent, r, x, shunt_g, shunt_b, ratio, source_pu, tolerance, max_sweeps, judged, band_pu,
    key, step, noise, share, rho, sigma, p_base, q_base, q_fixed, nodes, p_agent, q_agent, warm,
    over_buses, restart, per_row, converged, sweeps,
):  # fmt: skip
    """Run the pass over up to FEW environments, without the code for blocks; return how many have no solution.

    Each array is an argument, because the compiler's dispatcher takes several times as long for tuples of arrays.
    """
    noise_out, v_pu, p, q = over_buses[0], over_buses[1], over_buses[2], over_buses[3]
    _draw(
        first, last, key, step, noise, share, rho, sigma, p_base, q_base, q_fixed, nodes, p_agent, q_agent,
        noise_out, p, q,
    )  # fmt: skip
    empty, v0_pu = noise[:0], per_row[6]
    v0_pu[:] = source_pu
    failed = distflow_rows(
        order, parent, r, x, shunt_g, shunt_b, ratio, p, q, v0_pu, warm, tolerance, max_sweeps,
        (v_pu, empty, empty, restart, per_row[4], converged, sweeps, per_row[5]),
    )  # fmt: skip
    fill_figures(v_pu, first, last, judged, band_pu, per_row[0], per_row[1], per_row[2], per_row[3])
    return failed


@compiled(nogil=True)
def _many_rows(
    first, last, order, parent, r, x, shunt_g, shunt_b, ratio, source_pu, tolerance, max_sweeps, judged, band_pu,
    key, step, noise, share, rho, sigma, p_base, q_base, q_fixed, nodes, p_agent, q_agent, warm,
    over_buses, restart, per_row, converged,
):  # fmt: skip
    """Run the pass over the environments ``first`` up to ``last`` in chunks; return how many have no solution."""
    n, failed = noise.shape[1], 0
    noise_out, v_pu = over_buses[0], over_buses[1]
    most, empty = min(CHUNK, last - first), np.empty((0, 0))
    p, q = np.empty((most, n)), np.empty((most, n))
    sweeps, residual, v0_pu = np.empty(most, np.int64), np.empty(most), np.full(most, source_pu)
    for a in range(first, last, CHUNK):
        b = min(a + CHUNK, last)
        m = b - a
        _draw(
            a, b, key, step, noise, share, rho, sigma, p_base, q_base, q_fixed, nodes, p_agent, q_agent,
            noise_out, p[:m], q[:m],
        )  # fmt: skip
        out = (v_pu[a:b], empty, empty, restart[a:b], per_row[4, a:b], converged[a:b], sweeps[:m], residual[:m])
        sweeps[:m], unsettled = 0, m
        if m > FEW and n <= MOST_IN_BLOCKS:
            unsettled = distflow_blocks(
                order, parent, r, x, shunt_g, shunt_b, ratio, p[:m], q[:m], v0_pu[:m], warm[a:b], tolerance,
                max_sweeps, out,
            )  # fmt: skip
        if unsettled > 0:
            failed += distflow_rows(
                order, parent, r, x, shunt_g, shunt_b, ratio, p[:m], q[:m], v0_pu[:m], warm[a:b], tolerance,
                max_sweeps, out,
            )  # fmt: skip
        fill_figures(v_pu, a, b, judged, band_pu, per_row[0], per_row[1], per_row[2], per_row[3])
    return failed
