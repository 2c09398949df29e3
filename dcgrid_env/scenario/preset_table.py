"""Table of the bundled scenarios; docs/scenarios.md describes their purpose."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from dcgrid_env.scenario import presets_balanced as balanced
from dcgrid_env.scenario import presets_sites as sites
from dcgrid_env.scenario import presets_three_phase as three_phase
from dcgrid_env.scenario.scenario import Scenario


class Preset(NamedTuple):
    """Bundled scenario. This is the only place where it is registered."""

    name: str
    gym_id: str
    """Id in the registries of Gymnasium and PettingZoo."""
    about: str
    """One-line description."""
    make: Callable[[], Scenario]


TABLE = (
    Preset(
        "toy6",
        "dcgrid/Toy6-v0",
        "6 buses; one 2.5 MW data centre steps from idle to full at t = 20 s (the paper's Fig. 3)",
        balanced.toy6,
    ),
    Preset(
        "ieee123",
        "dcgrid/IEEE123-v0",
        "IEEE 123-bus equivalent, 5 data centres of 280 kW at random, 7 inverters (the paper's study)",
        balanced.ieee123,
    ),
    Preset(
        "ieee33-weak",
        "dcgrid/IEEE33Weak-v0",
        "33 buses of high r/x, 3 data centres of 1 MW at the ends; reactive power alone is not enough",
        balanced.ieee33_weak,
    ),
    Preset(
        "ieee33",
        "dcgrid/IEEE33-v0",
        "33 buses, 4 data centres of 600 kW, 6 inverters of 500 kvar; the place of an inverter matters",
        balanced.ieee33,
    ),
    Preset("das69", "dcgrid/Das69-v0", "69 buses, 4 data centres of 1 MW at the ends, 6 inverters", balanced.das69),
    Preset(
        "khodr141",
        "dcgrid/Khodr141-v0",
        "141 buses of a city, 4 data centres of 2.5 MW, 6 inverters",
        balanced.khodr141,
    ),
    Preset(
        "bursty",
        "dcgrid/Bursty-v0",
        "ieee33-weak under code completion: bursts of ten seconds and silence",
        balanced.bursty,
    ),
    Preset("sync", "dcgrid/Sync-v0", "ieee33 with 4 sites of 1 MW that all ramp together", balanced.sync),
    Preset(
        "training",
        "dcgrid/Training-v0",
        "ieee33-weak with training jobs of 600 kW, near the rating and near idle in turn, dt = 0.1 s",
        balanced.training,
    ),
    Preset(
        "mixed",
        "dcgrid/Mixed-v0",
        "ieee33 with PV at the inverters under passing clouds: at noon more load helps",
        balanced.mixed,
    ),
    Preset(
        "fault",
        "dcgrid/Fault-v0",
        "ieee123 with inverters of 150 kvar; an inverter or a capacitor is lost, a data centre trips and returns",
        balanced.fault,
    ),
    Preset(
        "robust",
        "dcgrid/Robust-v0",
        "ieee33 with a wrong model, noisy and late measurements and no preview",
        balanced.robust,
    ),
    Preset(
        "wrong-model",
        "dcgrid/WrongModel-v1",
        "sync in bursts of code completion; the model has other switches closed and wrong R and X",
        balanced.wrong_model,
    ),
    Preset(
        "late-measurements",
        "dcgrid/LateMeasurements-v1",
        "mixed with voltages that are 5 s old and noisy, a wrong model, neighbours in view and no preview",
        balanced.late_measurements,
    ),
    Preset(
        "scale-32",
        "dcgrid/Scale32-v0",
        "khodr141 with 32 data centres of 500 kW at random and 8 inverters",
        balanced.scale_32,
    ),
    Preset(
        "ieee13-3ph",
        "dcgrid/IEEE13ThreePhase-v1",
        "IEEE 13 node feeder with its phases, 2 data centres of 500 kW, 4 inverters of one to three phases",
        three_phase.ieee13_3ph,
    ),
    Preset(
        "ieee34-3ph",
        "dcgrid/IEEE34ThreePhase-v1",
        "IEEE 34 node feeder with its phases, long and weak, 2 data centres of 250 kW, 5 inverters",
        three_phase.ieee34_3ph,
    ),
    Preset(
        "ieee123-3ph",
        "dcgrid/IEEE123ThreePhase-v1",
        "IEEE 123 node feeder with its phases and regulators that act: the paper's study on the true feeder",
        three_phase.ieee123_3ph,
    ),
    Preset(
        "ieee13-3ph-published",
        "dcgrid/IEEE13ThreePhasePublished-v1",
        "ieee13-3ph with the published set points of its regulators, resetting timers and no price on taps",
        three_phase.ieee13_3ph_published,
    ),
    Preset(
        "ieee34-3ph-published",
        "dcgrid/IEEE34ThreePhasePublished-v1",
        "ieee34-3ph with the published set points of its regulators, resetting timers and no price on taps",
        three_phase.ieee34_3ph_published,
    ),
    Preset(
        "ieee123-3ph-published",
        "dcgrid/IEEE123ThreePhasePublished-v1",
        "ieee123-3ph with the published set points of its regulators, resetting timers and no price on taps",
        three_phase.ieee123_3ph_published,
    ),
    Preset(
        "ieee123-3ph-day",
        "dcgrid/IEEE123ThreePhaseDay-v1",
        "ieee123-3ph-published over a day in steps of a minute with PV; agents choose set points of regulators too",
        three_phase.ieee123_3ph_day,
    ),
    Preset(
        "ride-through",
        "dcgrid/RideThrough-v1",
        "34 nodes under the six dips of July 2024: 3 sites of 450 kW leave for their UPS and return, PV trips",
        three_phase.ride_through,
    ),
    Preset(
        "ieee33-weak-ups",
        "dcgrid/IEEE33WeakUPS-v0",
        "bursty with 300 kW and 5 kWh of a UPS at each data centre: storage beside the clock",
        balanced.ieee33_weak_ups,
    ),
    Preset(
        "smoothing",
        "dcgrid/Smoothing-v0",
        "ieee33-weak with training jobs over ten minutes in steps of 0.1 s; agents set GPU power smoothing",
        sites.smoothing,
    ),
    Preset(
        "routing",
        "dcgrid/Routing-v0",
        "4 sites of 1 MW under code completion that move half of their work, with a target and a deadline",
        sites.routing,
    ),
    Preset(
        "load-target",
        "dcgrid/LoadTarget-v0",
        "ieee33-weak with sites of 600 kW that a utility asks to draw less for 40 to 50 s",
        sites.load_target,
    ),
    Preset(
        "zero-shot",
        "dcgrid/ZeroShot-v0",
        "random feeders of 60 buses, another in each batch of training and 64 to be tested on; 4 sites of 1 MW",
        balanced.zero_shot,
    ),
)
"""All presets, in the order in which they are listed."""
