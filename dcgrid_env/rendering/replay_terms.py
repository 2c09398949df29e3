"""Words on the replay page that it explains, in the sentences of docs/glossary.md."""

TERMS = {
    "J": "The cost of an episode, lower is better.",
    "p.u.": "A quantity divided by its base, p.u.",
    "band": "The allowed voltage range, 1 p.u. plus or minus cost.band_pu (0.05).",
    "violation": "The voltage deviation beyond the band, p.u.",
    "V2 / V1": "The negative-sequence over the positive-sequence voltage of a bus.",
    "demand": "The draw in the next interval at the top clock with an empty queue, kW.",
    "reactive power": "Power that does no work but changes the voltage, kvar.",
    "clock": "The frequency of the GPUs, MHz; a lower clock reduces power and speed.",
    "backlog": "Work that waits, kW s; agents observe it in seconds at the rating.",
    "burnt": "Power drawn only to hold a floor or a slow ramp, kW.",
    "stored energy": "A device that stores energy and returns it with losses.",
    "relay deviation": "The relay volts of a regulator minus their target, in half bands; beyond 1 it is out of band.",
    "tap": "A transformer that changes the voltage in steps, its taps.",
    "inverter": "Power electronics between a device and the grid, kVA.",
    "substation": "The supply point of the feeder, with a fixed voltage on balanced feeders.",
}
"""The explanation of each word as the page shows it; a test compares them with the glossary."""
