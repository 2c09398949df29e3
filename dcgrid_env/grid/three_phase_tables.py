"""Component tables of a three-phase grid other than its source and nodes.

``phases`` is a text such as ``"abc"`` or ``"bc"``, the phases in the order of the alphabet. A matrix has three rows of
three figures for the phases a, b and c, NaN where a phase does not exist. A load or capacitor has three legs: in the
connection ``wye`` from a, b and c to ground, in ``delta`` from a to b, b to c and c to a. A connection can also name
its legs, as in ``"ad bd cd"``, from a, b and c to the conductor d. Conductors other than phases, such as neutrals, have
the letters from d on. The two halves of a split-phase winding are a and b of their bus.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dcgrid_env.grid.table import Table, optional_column

Matrix = Sequence[Sequence[float]]
Legs = Sequence[float]
"""One figure for each of three legs."""
LETTERS = "abcdefghijklmnopqrstuvwxyz"
"""Letters of the phases and other conductors 1 to 26."""
CONNECTIONS = ("wye", "delta")
LOAD_MODELS = ("PQ", "I", "Z", "CVR", "ZIP", "EXP")
WINDINGS = (("wye_grounded", "wye_grounded"), ("delta", "wye_grounded"), ("delta", "delta"))
RATINGS = {
    "phase_line": "rating_a",
    "switch": "rating_a",
    "transformer": "rating_kva",
    "regulator": "rating_kva_per_phase",
    "admittance": "rating_a",
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
    connection: Sequence[str] = optional_column()
    """``wye`` from the phases to ground, ``delta`` between two phases, or legs such as ``"ad bd cd"``.

    With legs the windings of the to-side end at the conductor d. Without the column all are ``wye``. ``kv_ln`` and
    ``kva_per_phase`` are those of a winding. The relay measures the voltage across the winding of its phase."""
    sensed_bus: Sequence[str] = optional_column()
    """Bus where the relay measures the voltage of ``sensed_phase`` to ground, without line-drop compensation; empty
    for its own winding. ``pt_ratio`` is then that of the bus."""
    z_ldc_v: Sequence[float] = optional_column()
    """Compensation by the magnitude of the current alone, subtracted from the magnitude of the voltage; 0 for none."""

    def windings(self, row: int) -> list[tuple[str, str]]:
        """One or two conductors of the winding at the from-side and at the to-side, of each phase."""
        phases, connection = self.phases[row], self.connection[row] if self.connection else "wye"
        if connection == "wye":
            return [(phase, phase) for phase in phases]
        return [(phases, phases)] if connection == "delta" else [(leg[0], leg) for leg in connection.split()]

    def relay_bus(self, row: int) -> str:
        """Bus where the relay measures the voltage."""
        return (self.sensed_bus[row] if self.sensed_bus else "") or self.to_bus[row]

    def is_wye(self, row: int) -> bool:
        """Whether all windings end at ground."""
        return not self.connection or self.connection[row] == "wye"


@dataclass(frozen=True)
class AdmittanceTable(Table):
    """One row for each linear element that no other table can hold, by its primitive admittance matrix.

    Its currents into the element are I = (G + jB) V over its nodes, for voltages to ground.
    """

    name: Sequence[str] = ()
    kind: Sequence[str] = ()
    """What it is, such as ``transformer``; for information alone."""
    nodes: Sequence[str] = ()
    """Its nodes by bus and phase, as in ``"650.a 650.b 651.a"``."""
    g_s: Sequence[Sequence[float]] = ()
    """Upper triangle of the symmetric conductance matrix, row by row, S."""
    b_s: Sequence[Sequence[float]] = ()
    """Upper triangle of the symmetric susceptance matrix, row by row, S."""
    rating_a: Sequence[float] = optional_column()
    """Rated current at each of the nodes that it feeds, A; NaN where it is not known."""


@dataclass(frozen=True)
class PhaseLoadTable(Table):
    """One row for each load of up to three legs; consumption is positive."""

    name: Sequence[str] = ()
    bus: Sequence[str] = ()
    connection: Sequence[str] = ()
    model: Sequence[str] = ()
    """How power depends on voltage: PQ constant, I with its first power, Z with its second.

    CVR is active with the first and reactive with the second power, ZIP has the shares of ``zip``, and EXP the
    ``exponents``."""
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
    exponents: Sequence[Sequence[float]] = optional_column()
    """Powers of the voltage with which p and q go, two figures, or none for other models. Beyond ``vmin_pu`` and
    ``vmax_pu`` such a load has the law of constant power there, with a jump."""


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
    is_fixed: Sequence[int] = optional_column()
    """1 for a bank that stays in this state, because its control in the file does not act; 0 for the others."""


@dataclass(frozen=True)
class CapacitorControlTable(Table):
    """One row for each capacitor bank whose built-in control has individual settings.

    ``voltage`` and ``power_factor`` switch on below ``on_at`` and off above ``off_at``, ``current`` and ``kvar`` on
    above ``on_at`` and off below ``off_at``. Current and power are those that flow at ``from_bus`` towards ``to_bus``.
    """

    name: Sequence[str] = ()
    capacitor: Sequence[str] = ()
    """Name of the bank."""
    measures: Sequence[str] = ()
    bus: Sequence[str] = ()
    """Bus where voltages are measured."""
    legs: Sequence[str] = ()
    """Where: phases to ground, as in ``"a b c"``, or pairs of phases, as in ``"ab"``."""
    legs_of: Sequence[str] = ()
    """The ``mean``, ``max`` or ``min`` of these voltages counts."""
    from_bus: Sequence[str] = ()
    """Bus of the current transformers; empty if only voltage is measured."""
    to_bus: Sequence[str] = ()
    """Bus at the other end of the line; empty if only voltage is measured."""
    phases: Sequence[str] = ()
    """Phases of the current or power; powers of several are added."""
    phases_of: Sequence[str] = ()
    """The ``mean``, ``max`` or ``min`` of these currents counts."""
    on_at: Sequence[float] = ()
    """Secondary V, secondary A or kvar. A power factor is from 0 to 1, or, leading, 2 less it."""
    off_at: Sequence[float] = ()
    pt_ratio: Sequence[float] = ()
    ct_ratio: Sequence[float] = ()
    delay_on_s: Sequence[float] = ()
    """Time for which the threshold is passed before the bank switches on."""
    delay_off_s: Sequence[float] = ()
    dead_time_s: Sequence[float] = ()
    """Least time from a switching off to the beginning of the delay before the next switching on."""
    low_v: Sequence[float] = optional_column()
    """Secondary voltage below which the bank switches on in any case; NaN for none."""
    high_v: Sequence[float] = optional_column()
    """Secondary voltage above which the bank switches off in any case; NaN for none."""
    least_kvar: Sequence[float] = optional_column()
    """Reactive power below which the power factor does not switch the bank on; NaN for none."""
    after: Sequence[str] = optional_column()
    """Bank of the same place that is on before this one switches on, and until this one is off; or empty."""


CONTROL_MEASURES = ("voltage", "current", "kvar", "power_factor")
STATISTICS = ("mean", "max", "min")


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
