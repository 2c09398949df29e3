"""Fields of feeders that the fast paths and the array forms take into account, see ``core.coverage``.

A fast path that covers less lists the record itself. A new field belongs here only once all of them take it into
account; until then a feeder in which it is not at its default is refused.
"""

from __future__ import annotations

from dcgrid_env.grid.feeder import Feeder
from dcgrid_env.grid.network import (
    AdmittanceTable,
    CapacitorControlTable,
    CapacitorTable,
    CoreTable,
    LineTable,
    LoadTable,
    Network,
    NodeTable,
    PhaseLineTable,
    PhaseLoadTable,
    RatingTable,
    RegulatorTable,
    ShuntTable,
    SourceTable,
    SwitchTable,
    TransformerTable,
)
from dcgrid_env.grid.three_phase import ThreePhaseFeeder

BALANCED: dict[type, str] = {
    Feeder: """
        name base_kv v0_pu bus_ids* p_load_kw q_load_kvar capacitor_kvar parent r_ohm x_ohm x y shunt_kw shunt_kvar
        voltage_ratio bus_base_kv rating_a loop_ends seasonal_ratings*
    """,
}
"""A balanced feeder."""

_TABLES: dict[type, str] = {
    SourceTable: "bus base_kv v_pu angle_deg r_ohm x_ohm",
    NodeTable: "bus phase x y base_kv_ln base_kv voltage_ratio",
    LineTable: "from_bus to_bus r_ohm x_ohm rating_a",
    LoadTable: "bus phase p_kw q_kvar",
    ShuntTable: "bus phase capacitor_kvar shunt_kw shunt_kvar",
    PhaseLineTable: "name from_bus to_bus phases length_m r_ohm x_ohm b_us rating_a",
    SwitchTable: "name from_bus to_bus phases state r_ohm x_ohm rating_a",
    TransformerTable: """
        name from_bus to_bus phases connection_from connection_to kva kv_ll_from kv_ll_to r_percent x_percent
        shift_deg antifloat_ppm rating_kva
    """,
    RegulatorTable: """
        name bank from_bus to_bus phases sensed_phase kv_ln kva_per_phase r_percent x_percent tap tap_neutral tap_min
        tap_max tap_step vreg_v band_v pt_ratio ct_primary_a r_ldc_v x_ldc_v delay_s tap_delay_s max_taps_per_move
        antifloat_ppm rating_kva_per_phase connection sensed_bus z_ldc_v
    """,
    PhaseLoadTable: "name bus connection model leg_kv p_kw q_kvar vmin_pu vmax_pu vlow_pu zip exponents",
    CapacitorTable: "name bus connection leg_kv kvar state is_fixed",
    CapacitorControlTable: """
        name capacitor measures bus legs legs_of from_bus to_bus phases phases_of on_at off_at pt_ratio ct_ratio
        delay_on_s delay_off_s dead_time_s low_v high_v least_kvar after
    """,
    CoreTable: "name bus connection leg_kv p_kw q_kvar",
    AdmittanceTable: "name kind nodes g_s b_s rating_a",
    RatingTable: "element season normal emergency",
}
THREE_PHASE: dict[type, str] = {
    ThreePhaseFeeder: "network",
    Network: """
        name source node line load shunt phase_line switch transformer regulator phase_load capacitor
        capacitor_control core admittance rating frequency_hz source_of_facts
    """,
    **{kind: " ".join(f"{column}*" for column in columns.split()) for kind, columns in _TABLES.items()},
}
"""A three-phase feeder with its tables."""
