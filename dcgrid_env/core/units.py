"""The one place where kW, kvar and ohm meet per unit.

Per unit lives inside the power flow only. Power is on one base for every feeder, so that figures of different feeders
compare; impedance is on the base that this power and the feeder's line-to-line voltage give.
"""

S_BASE_KVA = 1000.0
"""Base power, kVA (three-phase)."""


def impedance_base_ohm(base_kv: float) -> float:
    """Impedance base, ohm per phase, of a feeder whose line-to-line base voltage is ``base_kv``."""
    return base_kv**2 / (S_BASE_KVA / 1000.0)
