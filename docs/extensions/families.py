"""Families of scenarios in the order in which the site shows them; each preset belongs to one."""

from __future__ import annotations

from typing import NamedTuple


class Family(NamedTuple):
    """Scenarios that ask the same question."""

    title: str
    about: str
    presets: dict[str, str]
    """The problem that each preset poses, by its name."""
    read_on: tuple[str, ...]
    """Pages with details, without their suffix."""


FAMILIES = (
    Family(
        "The paper's study and the main example",
        "Start here: a tiny feeder, the paper's feeder, and a weak feeder on which control matters.",
        {
            "toy6": (
                "One large data centre goes from idle to full power in one step. The feeder has six buses, so "
                "every effect can be followed by hand. Use it for tests and for a first look at the environment."
            ),
            "ieee123": (
                "Five data centres at random buses raise and lower their power with inference load. The feeder is "
                "strong, so the right constant reactive power already gains almost everything. Use it to "
                "reproduce the paper."
            ),
            "ieee33-weak": (
                "Three large data centres are connected to the ends of a weak feeder. At peak load reactive power "
                "alone cannot keep the voltage above 0.95 p.u.; clocks must be lowered in time, and the delayed "
                "work must be served later."
            ),
        },
        ("reproduction", "scenarios"),
    ),
    Family(
        "Other balanced feeders",
        "Feeders of 33 to 141 buses, on which the location of a device matters.",
        {
            "ieee33": (
                "Inverters differ in their effect on the voltage, because they are connected to different "
                "branches. An agent has to find out how much its reactive power matters at its bus."
            ),
            "das69": (
                "Four data centres at the ends of a 69-bus feeder leave little headroom: the tuned droop is "
                "already close to perfect foresight."
            ),
            "khodr141": (
                "A city feeder with large data centres and few inverters. Losses and voltage drops spread over "
                "many buses, so each agent observes only a small part of the effect of its action."
            ),
            "scale-32": ("Thirty-two data centres act at once. Use it to test how well multi-agent learning scales."),
        },
        ("scenarios", "feeder-model"),
    ),
    Family(
        "Fast-changing loads, weather, faults and wrong models",
        "The same feeders with harder workloads, disturbances and measurements.",
        {
            "bursty": (
                "Code completion loads the sites in bursts of about ten seconds. Control has to react within a "
                "second and must not waste the pauses."
            ),
            "sync": (
                "All sites raise their power at the same time, as in synchronous training. Their voltage drops "
                "add up, so the sites have to share the reduction."
            ),
            "training": (
                "Training jobs alternate between full power and near idle in steps of 0.1 s. Control has to act "
                "within tenths of a second."
            ),
            "mixed": (
                "Photovoltaic power under passing clouds raises the voltage at noon. Agents have to absorb "
                "reactive power, and may need to serve more work, not less."
            ),
            "fault": (
                "An inverter or a capacitor is lost during the episode, and a data centre disconnects and "
                "reconnects. The remaining agents have to compensate."
            ),
            "wrong-model": (
                "The given model of the feeder has four switches in other positions than the feeder, wrong resistances "
                "and wrong reactances, and nobody meters the other loads. Controllers that plan with this model act "
                "on the wrong buses; a policy can learn the true effect of its actions."
            ),
            "late-measurements": (
                "Voltages are noisy and five seconds old, solar power changes with passing clouds, and the model is "
                "wrong. Agents observe their neighbours' voltages and have to infer what the present ones are."
            ),
            "robust": (
                "Measurements are noisy and late, the demand of the next step is unknown, and the given "
                "sensitivities are wrong. Use it to test controllers that rely on a model."
            ),
        },
        ("tasks", "traces", "scenarios", "flicker-and-ramps"),
    ),
    Family(
        "Three phases",
        "IEEE feeders with unbalanced phases, regulators and capacitor banks.",
        {
            "ieee13-3ph": (
                "A short feeder with strongly unbalanced phases, single-phase inverters and acting regulators. "
                "Action on one phase changes the voltage of the others."
            ),
            "ieee34-3ph": (
                "A long and weak feeder whose regulators act during the episode. It is the three-phase "
                "counterpart of `ieee33-weak`."
            ),
            "ieee123-3ph": (
                "The paper's study on the full feeder. Voltage regulators act during the episode; their delays and "
                "dead bands interact with the agents."
            ),
            "ieee13-3ph-published": (
                "`ieee13-3ph` with the published set points of its regulators. They keep the far end above 1 p.u., "
                "so most of the cost can only be saved by making the regulators tap."
            ),
            "ieee34-3ph-published": "`ieee34-3ph` with the published set points of its regulators.",
            "ieee123-3ph-published": "`ieee123-3ph` with the published set points of its regulators.",
            "ieee123-3ph-day": (
                "A day in steps of one minute with solar power. Agents also choose the set points of regulators and "
                "capacitors, which should switch rarely."
            ),
        },
        ("three-phase", "reproduction-3ph"),
    ),
    Family(
        "Sites with more than a clock",
        "Agents that also control a battery, power smoothing, the location of work or reconnection after a sag, or "
        "that meet a utility's request.",
        {
            "ieee33-weak-ups": (
                "Each data centre has a small battery. It covers short peaks, but has to be charged again before "
                "the next one."
            ),
            "smoothing": (
                "Training jobs exceed the utility's limits on ramps. Agents set a power floor and ramp limits, "
                "and pay for the power that is burnt."
            ),
            "routing": (
                "Four sites can move up to half of their work to each other, with latency and deadlines. Work "
                "should run where the feeder is strong at that moment."
            ),
            "load-target": (
                "A utility asks the data centres to draw a quarter less for less than a minute. They have to defer "
                "work in time, share the reduction, and serve their queues afterwards without a new peak."
            ),
            "ride-through": (
                "Six voltage sags disconnect data centres, which then run on their UPS. Agents decide when to "
                "reconnect. If all reconnect at once, the voltage drops again."
            ),
        },
        ("storage", "smoothing", "routing", "load-target", "ride-through", "sag-study"),
    ),
    Family(
        "Unseen feeders",
        "Random feeders: new ones in each training batch, and held-out ones for the test.",
        {
            "zero-shot": (
                "A policy has to control feeders that it has never seen. It can only rely on its measurements and "
                "on what they have in common."
            ),
        },
        ("random-feeders", "generalise", "carry-over"),
    ),
)


def family_of(preset: str) -> Family:
    """Return the family of a preset; raise ValueError for one that belongs to none."""
    for family in FAMILIES:
        if preset in family.presets:
            return family
    raise ValueError(f"preset {preset!r} belongs to no family; add it to FAMILIES in docs/extensions/families.py")
