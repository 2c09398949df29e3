"""Families of scenarios, in the order in which the site shows them; every preset stands in one."""

from __future__ import annotations

from typing import NamedTuple


class Family(NamedTuple):
    """Scenarios that ask the same question."""

    title: str
    about: str
    presets: tuple[str, ...]
    read_on: tuple[str, ...]
    """Pages that say more, without their suffix."""


FAMILIES = (
    Family(
        "The paper's study and the headline",
        "Generated inference load and load noise. On `ieee33-weak` the band is lost at peak and the clock must help.",
        ("toy6", "ieee123", "ieee33-weak"),
        ("reproduction", "scenarios"),
    ),
    Family(
        "Other balanced feeders",
        "Feeders of 33 to 141 buses on which the place of an inverter or a site decides.",
        ("ieee33", "das69", "khodr141", "scale-32"),
        ("scenarios", "feeder-model"),
    ),
    Family(
        "Loads that jump, weather, faults, wrong models",
        "What load, sky and sensors do: bursts, sites in step, training jobs, clouds, losses, noise and delay.",
        ("bursty", "sync", "training", "mixed", "fault", "robust"),
        ("traces", "scenarios", "flicker-and-ramps"),
    ),
    Family(
        "Three phases",
        "The IEEE feeders with their phases, their regulators and their capacitor banks.",
        ("ieee13-3ph", "ieee34-3ph", "ieee123-3ph", "ieee123-3ph-day"),
        ("three-phase", "reproduction-3ph"),
    ),
    Family(
        "Sites with more than a clock",
        "Agents that also decide on a battery, on power smoothing, on where work runs, and on the return after a sag.",
        ("ieee33-weak-ups", "smoothing", "routing", "ride-through"),
        ("storage", "smoothing", "routing", "ride-through", "sag-study"),
    ),
    Family(
        "Feeders that nobody saw",
        "A new random feeder in each batch of training, and others to be tested on.",
        ("zero-shot",),
        ("random-feeders", "generalise", "carry-over"),
    ),
)


def family_of(preset: str) -> Family:
    """The family of a preset; ValueError, naming this file, for one that stands in none."""
    for family in FAMILIES:
        if preset in family.presets:
            return family
    raise ValueError(f"preset {preset!r} stands in no family; add it to FAMILIES in docs/extensions/families.py")
