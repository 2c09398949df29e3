"""Component tables of a three-phase grid other than its source and nodes.

``phases`` is a text such as ``"abc"`` or ``"bc"``, the phases in the order of the alphabet. A matrix has three rows of
three figures for the phases a, b and c, NaN where a phase does not exist. A load or capacitor has three legs: in the
connection ``wye`` from a, b and c to ground, in ``delta`` from a to b, b to c and c to a.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dcgrid_env.grid.table import Table, optional_column

Matrix = Sequence[Sequence[float]]
Legs = Sequence[float]
"""One figure for each of three legs."""
CONNECTIONS = ("wye", "delta")
LOAD_MODELS = ("PQ", "I", "Z", "CVR", "ZIP")
WINDINGS = (("wye_grounded", "wye_grounded"), ("delta", "wye_grounded"), ("delta", "delta"))
RATINGS = {
    "phase_line": "rating_a",
    "switch": "rating_a",
    "transformer": "rating_kva",
    "regulator": "rating_kva_per_phase",
}
"""Optional column with the rating of each kind of branch."""
FALLBACKS = {"rating_a": None, "rating_kva": "kva", "rating_kva_per_phase": "kva_per_phase"}
"""Column that is the rating where the optional one is missing; None if the rating is then unknown."""
"""Connections of a transformer's from-side and to-side that can be compiled."""


@dataclass(frozen=True)
class PhaseLineTable(Table):
    """One row for each line, of its whole length; half of its shunt susceptance is at either end."""

    name: Sequence[str] = ()
    from_bus: Sequence[str] = ()
    to_bus: Sequence[str] = ()
    phases: Sequence[str] = ()
    length_m: Sequence[float] = ()
    """For information alone; NaN where it is not known."""
    r_ohm: Sequence[Matrix] = ()
    x_ohm: Sequence[Matrix] = ()
    b_us: Sequence[Matrix] = ()
    """Shunt susceptance, microsiemens."""
    rating_a: Sequence[float] = optional_column()
    """Ampacity of each conductor, A; NaN where it is not known."""


@dataclass(frozen=True)
class SwitchTable(Table):
    """One row for each switch, ``closed`` or ``open``; a closed one has a separate impedance for each phase."""

    name: Sequence[str] = ()
    from_bus: Sequence[str] = ()
    to_bus: Sequence[str] = ()
    phases: Sequence[str] = ()
    state: Sequence[str] = ()
    r_ohm: Sequence[float] = ()
    x_ohm: Sequence[float] = ()
    rating_a: Sequence[float] = optional_column()
    """Ampacity of each phase, A; NaN where it is not known."""


@dataclass(frozen=True)
class TransformerTable(Table):
    """One row for each transformer, fed at its from-side; its impedance is on its own rating."""

    name: Sequence[str] = ()
    from_bus: Sequence[str] = ()
    to_bus: Sequence[str] = ()
    phases: Sequence[str] = ()
    connection_from: Sequence[str] = ()
    connection_to: Sequence[str] = ()
    kva: Sequence[float] = ()
    """Base of the impedance, of all phases together; it is the rating too, unless ``rating_kva`` is given."""
    kv_ll_from: Sequence[float] = ()
    """Line-to-line, also of a transformer of one phase."""
    kv_ll_to: Sequence[float] = ()
    r_percent: Sequence[float] = ()
    x_percent: Sequence[float] = ()
    shift_deg: Sequence[float] = ()
    """Angle of the to-side against the from-side: -30 or 30 for delta to grounded wye, 0 for the others."""
    antifloat_ppm: Sequence[float] = ()
    """Inductive admittance to ground that OpenDSS adds: half of it, in millionths of the rating, at each terminal."""
    rating_kva: Sequence[float] = optional_column()
    """Rating of all phases together, of the smaller winding; NaN where it is not known."""


@dataclass(frozen=True)
class RegulatorTable(Table):
    """One row for each voltage regulator with a separate tap: one phase, or several as a gang.

    V_to / V_from = 1 + ``tap_step`` times the tap; the series impedance is seen from the to-side times the squared
    ratio. The columns from ``vreg_v`` on are the control's, in relay volts (on a base of 120 V).
    """

    name: Sequence[str] = ()
    bank: Sequence[str] = ()
    from_bus: Sequence[str] = ()
    to_bus: Sequence[str] = ()
    phases: Sequence[str] = ()
    sensed_phase: Sequence[str] = ()
    kv_ln: Sequence[float] = ()
    kva_per_phase: Sequence[float] = ()
    r_percent: Sequence[float] = ()
    x_percent: Sequence[float] = ()
    tap: Sequence[int] = ()
    tap_neutral: Sequence[int] = ()
    tap_min: Sequence[int] = ()
    tap_max: Sequence[int] = ()
    tap_step: Sequence[float] = ()
    vreg_v: Sequence[float] = ()
    band_v: Sequence[float] = ()
    """Whole width of the band."""
    pt_ratio: Sequence[float] = ()
    ct_primary_a: Sequence[float] = ()
    r_ldc_v: Sequence[float] = ()
    x_ldc_v: Sequence[float] = ()
    delay_s: Sequence[float] = ()
    """Before the first tap."""
    tap_delay_s: Sequence[float] = ()
    """Between further taps."""
    max_taps_per_move: Sequence[int] = ()
    """0 for a fixed tap."""
    antifloat_ppm: Sequence[float] = ()
    rating_kva_per_phase: Sequence[float] = optional_column()
    """Rating of a phase; NaN where it is not known. Without the column it is ``kva_per_phase``."""


@dataclass(frozen=True)
class PhaseLoadTable(Table):
    """One row for each load of up to three legs; consumption is positive."""

    name: Sequence[str] = ()
    bus: Sequence[str] = ()
    connection: Sequence[str] = ()
    model: Sequence[str] = ()
    """How power goes with voltage: PQ constant, I with its first power, Z with its second, CVR active with the first
    and reactive with the second, ZIP by the shares of ``zip``."""
    leg_kv: Sequence[float] = ()
    """Rated voltage across a leg."""
    p_kw: Sequence[Legs] = ()
    q_kvar: Sequence[Legs] = ()
    vmin_pu: Sequence[float] = ()
    """Share of the rated voltage: below it the current falls linearly to that of the rated impedance at ``vlow_pu``."""
    vmax_pu: Sequence[float] = ()
    """Above it the load is the impedance that meets its law at ``vmax_pu``."""
    vlow_pu: Sequence[float] = ()
    """Below it the load is its rated impedance."""
    zip: Sequence[Sequence[float]] = ()
    """Shares of constant impedance, current and power in p, then in q; six figures, or none for other models."""


@dataclass(frozen=True)
class CapacitorTable(Table):
    """One row for each capacitor bank, which is switched as one: a constant susceptance a leg."""

    name: Sequence[str] = ()
    bus: Sequence[str] = ()
    connection: Sequence[str] = ()
    leg_kv: Sequence[float] = ()
    kvar: Sequence[Legs] = ()
    """Injection at ``leg_kv``."""
    state: Sequence[str] = ()
    """``on`` or ``off`` in the base case."""


@dataclass(frozen=True)
class CoreTable(Table):
    """One row for each transformer core: a constant admittance a leg. Its active power is a loss, not a load."""

    name: Sequence[str] = ()
    bus: Sequence[str] = ()
    connection: Sequence[str] = ()
    leg_kv: Sequence[float] = ()
    p_kw: Sequence[Legs] = ()
    """No-load loss at ``leg_kv``."""
    q_kvar: Sequence[Legs] = ()
    """Magnetising power at ``leg_kv``."""
