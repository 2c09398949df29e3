"""Names of a scenario's fields: paths such as ``sensing.noise_pu``, short names of common fields, and former names.

A field of a part is given as ``sensing={"noise_pu": 0.005}``, as a table ``[sensing]`` of a scenario file, or by its
path: ``--set sensing.noise_pu=0.005``, and ``**{"sensing.noise_pu": 0.005}`` in Python.
"""

from __future__ import annotations

ALIASES = {
    "n_datacenters": "datacenters.count",
    "trace": "workload.trace",
    "observe": "sensing.observe",
    "weights": "cost.weights",
    "reward": "cost.reward",
}
"""Paths of common fields by their short names."""

FORMER = {
    "v0_pu": "source_voltage_pu",
    "datacenter_buses": "datacenters.buses",
    "p_rated_kw": "datacenters.p_rated_kw",
    "idle_share": "datacenters.idle_share",
    "f_min_mhz": "datacenters.f_min_mhz",
    "f_max_mhz": "datacenters.f_max_mhz",
    "s_rated_share": "datacenters.s_rated_share",
    "q_max_share": "datacenters.q_max_share",
    "dvfs": "datacenters.clock_law",
    "boost_share": "datacenters.boost_share",
    "datacenter_phases": "datacenters.phases",
    "datacenter_ride_through": "datacenters.ride_through",
    "datacenter_smoothing": "datacenters.smoothing",
    "datacenter_cooling": "datacenters.cooling",
    "datacenter_routing": "datacenters.routing",
    "datacenter_batching": "datacenters.batching",
    "datacenter_service": "datacenters.service",
    "datacenter_storage": "datacenters.storage",
    "inverter_buses": "inverters.buses",
    "inverter_s_kva": "inverters.s_rated_kva",
    "inverter_phases": "inverters.phases",
    "inverter_ride_through": "inverters.ride_through",
    "inverter_trace": "inverters.injection",
    "trace_scale": "workload.trace_scale",
    "recording_split": "workload.recording_split",
    "trace_window": "workload.window",
    "site_correlation": "workload.site_correlation",
    "compute_share": "workload.compute_share",
    "full_load_s": "workload.full_load_s",
    "capacitors": "background.capacitors",
    "load_sigma": "background.load_sigma",
    "load_rho": "background.load_rho",
    "start_hour": "background.start_hour",
    "voltage_noise_pu": "sensing.noise_pu",
    "measurement_delay": "sensing.delay_steps",
    "preview": "sensing.preview",
    "observe_loading": "sensing.loading",
    "r_model_share": "sensing.r_model_share",
    "x_model_share": "sensing.x_model_share",
    "regulators": "grid_control.regulators",
    "capacitor_banks": "grid_control.capacitors",
    "capacitor_settings": "grid_control.capacitor_settings",
    "band_pu": "cost.band_pu",
    "voltage_cost": "cost.voltage",
    "ramp_limit_kw_per_s": "cost.ramp_limit_kw_per_s",
    "ramp_window_s": "cost.ramp_window_s",
    "voltage_step_limit_pu": "cost.voltage_step_limit_pu",
}
"""Paths of fields by names that are refused; the error gives the path. Fingerprints use these names."""
