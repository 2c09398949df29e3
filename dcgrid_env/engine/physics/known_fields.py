"""Fields of scenarios that the fast paths take into account, see ``core.coverage``.

A fast path that covers less lists the record itself. A new field belongs here only once all fast paths take it into
account; until then a scenario in which it is not at its default takes the general path.
"""

from __future__ import annotations

from dcgrid_env.devices.capacitor_bank.capacitor_control import CapacitorControl
from dcgrid_env.devices.tap_changer.regulator_control import RegulatorControl
from dcgrid_env.engine.physics.state import Exogenous, LoadsToDraw
from dcgrid_env.scenario.background import Background
from dcgrid_env.scenario.cost import Cost
from dcgrid_env.scenario.grid_control import GridControl
from dcgrid_env.scenario.grid_request import GridRequest
from dcgrid_env.scenario.load_profiles import LoadProfiles
from dcgrid_env.scenario.scenario import Scenario
from dcgrid_env.scenario.sensing import Sensing
from dcgrid_env.scenario.workload import Workload

SCENARIO: dict[type, str] = {
    Scenario: """
        name feeder* source_voltage_pu devices* workload background sensing cost grid_control grid_request
        load_profiles faults* sags* horizon dt_s power_flow split
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
    LoadProfiles: "file* columns classes* unit between days start_h uncovered",
}
"""A scenario with its parts, without feeder and devices."""

OUTSIDE: dict[type, str] = {
    Exogenous: """
        p_load_kw q_load_kvar p_ref_kw p_inverter_kw nodes compute_share available legs capacitor_on sags trip_widths
        to_draw offset_v request
    """,
    LoadsToDraw: "key step noise share p_kw q_kvar",
}
"""Inputs of a step, arrays."""
