"""The forms of a scenario, for tests of code that must run on any scenario."""

import pytest

from dcgrid_env import PRESETS, CostWeights, PrefillDecodeDvfs, make_scenario

FORMS = ("toy6", "ieee123", "ieee33-weak", "mixed", "fault")
"""Presets of every form on a balanced feeder: a scripted trace, drawn buses, given buses, PV, faults."""
WORK_CLASSES = {"datacenters.clock_law": PrefillDecodeDvfs(), "datacenters.boost_share": 1.3, "trace": "mixed"}
"""Overrides that give data centres two classes of work, and draws above the rating."""
KINDS = (
    "toy6", "ieee123", "mixed", "fault", "ieee34-3ph", "ieee33-weak-ups", "routing", "ride-through", "smoothing",
    "zero-shot",
)  # fmt: skip
"""Presets that have all code between them: the balanced forms, three phases, every kind of device and channel, random
feeders. What one of the others runs, one of these runs too."""
VARIANTS = {
    "toy6": ("toy6", {"horizon": 25}),
    "placed at random": ("ieee123", {"horizon": 20}),
    "noise and delay": ("robust", {"horizon": 20}),
    "faults": ("fault", {}),
    "pv": ("mixed", {"horizon": 20}),
    "steps of 0.1 s": ("training", {"horizon": 20}),
    "two work classes": ("ieee33-weak", WORK_CLASSES | {"workload.site_correlation": 0.5, "horizon": 20}),
    "neighbours": ("ieee123", {"observe": "neighbours", "horizon": 8}),
    "feeder, noise and delay": ("robust", {"observe": "feeder", "horizon": 8}),
    "feeder": ("toy6", {"observe": "feeder", "horizon": 8}),
    "linear": ("ieee33", {"power_flow": "lindistflow", "horizon": 8}),
    "three phases": ("ieee13-3ph", {"horizon": 20}),
    "regulators as agents": (
        "ieee34-3ph",
        {
            "grid_control.regulators": "agent",
            "grid_control.capacitors": "agent",
            "weights": {"switching": 1.0},
            "horizon": 8,
        },
    ),
    "set points as agents": (
        "ieee13-3ph",
        {
            "grid_control.regulators": "setpoint",
            "grid_control.capacitors": "setpoint",
            "grid_control.regulator_settings": {"timer": "integrating"},
            "horizon": 8,
        },
    ),
    "requests of a utility": (
        "ieee33-weak",
        {
            "grid_request": {
                "targets": [
                    {"value_share": [0.2, 0.3], "begin_s": [2, 6], "ramp_s": 3, "duration_s": 8},
                    {"kind": "target", "value_mw": [0.8, 1.5], "begin_s": 14, "duration_s": 9, "priority": 1},
                ],
                "notice_s": 5.0,
            },
            "weights": {"grid_request": 2.0},
            "horizon": 20,
        },
    ),
    "other costs": ("ieee33", {"weights": CostWeights(clock=1.0, step=10.0, loss=2.0), "horizon": 8}),
}
"""By name a preset and overrides, short, so that every option that changes what is computed comes up."""


def each_preset(quick=KINDS, left_out=()):
    """Presets to run a test on, those that are not ``quick`` among the slow tests."""
    return [p if p in quick else pytest.param(p, marks=pytest.mark.slow) for p in PRESETS if p not in left_out]


def variant_of(name, split="test"):
    """The scenario of a variant."""
    preset, overrides = VARIANTS[name]
    return make_scenario(preset, split=split, **overrides)
