"""Sizes of storages from joules to hours, with the sources of the figures; figures without a source are choices."""

from __future__ import annotations

from typing import Any

GPU_ENERGY_J = 65.0
"""Energy of the capacitors in the power supplies of a GB300 NVL72 rack, J for each GPU (NVIDIA, "How new GB300 NVL72
features provide steady power for AI", 2025)."""
GPU_POWER_KW = 1.4
"""Rated power of a GB300 GPU, kW (NVIDIA's data sheet)."""
GPU_PEAK_SHARE = 0.3
"""Share of the peak that these capacitors take off the grid, at most (the first source)."""
UPS_MINUTES = 5.0
"""Time for which a UPS supplies the site, min.

This is the upper end of today's usual range of 30 s to 5 min; 15 min were usual earlier (EnerSys, "The right fit",
Electrical Review, May 2020).
"""
BESS_HOURS = 2.0
"""Time for which a battery at the grid gives its rated power, h: the least of NREL's Annual Technology Baseline 2024,
which has 2 to 10 h."""
BESS_ROUND_TRIP = 0.85
"""Share of the energy drawn that such a battery gives back (W. Cole and A. W. Frazier, "Cost projections for
utility-scale battery storage: 2020 update", NREL/TP-6A20-75385)."""

SUPERCAPACITOR: dict[str, Any] = {
    "charge_efficiency": 0.98,
    "discharge_efficiency": 0.98,
    "standby_share_per_h": 0.01,
    "initial_share": 0.5,
    "ageing_price": 0.0,
}
"""Fields of a capacitor: half full, so that it can take and give, and not worn by cycles in their hundred thousands."""
UPS: dict[str, Any] = {
    "charge_efficiency": 0.96,
    "discharge_efficiency": 0.96,
    "standby_share_per_h": 3e-5,
    "initial_share": 1.0,
    "ageing_price": 0.05,
}
"""Fields of a UPS: full, with a self-discharge of some 2 % a month, made for few cycles."""
BESS: dict[str, Any] = {
    "charge_efficiency": BESS_ROUND_TRIP**0.5,
    "discharge_efficiency": BESS_ROUND_TRIP**0.5,
    "standby_share_per_h": 3e-5,
    "initial_share": 0.5,
    "ageing_price": 0.02,
}
"""Fields of a battery at the grid: half full, its throughput priced as reactive effort is."""
