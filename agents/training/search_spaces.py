"""What a search over an algorithm's settings looks at: a range or choices for each field of its configuration.

The algorithm's own defaults lie within, and so do the settings that ship (a test holds that): searches begin with them.
"""

from __future__ import annotations

from typing import Any, NamedTuple


class Range(NamedTuple):
    """Numbers from low to high, on a logarithmic scale where so said."""

    low: float
    high: float
    log: bool = False


class Choice(NamedTuple):
    """Some values, in no order."""

    values: tuple[Any, ...]


GAMMAS = Choice((0.5, 0.9, 0.97, 0.99))
WAITS = Choice((10.0, 30.0, 60.0, 80.0, 150.0))
OUTPUTS = Choice(("setpoint", "change", "droop"))
YES_NO = Choice((False, True))

SPACES: dict[str, dict[str, Range | Choice]] = {
    "analytic": {
        "learning_rate": Range(1e-3, 3e-2, log=True),
        "window": Choice((20, 40, 60, 120)),
        "num_envs": Choice((16, 32, 64, 128)),
        "max_grad_norm": Range(0.1, 10.0, log=True),
    },
    "safe": {
        "learning_rate": Range(1e-3, 3e-2, log=True),
        "window": Choice((20, 40, 60, 120)),
        "margin": Range(0.2, 0.9),
    },
    "ppo": {
        "outputs": OUTPUTS,
        "nameplate": YES_NO,
        "gamma": GAMMAS,
        "wait": WAITS,
        "log_std": Range(-2.5, -0.3),
        "learning_rate": Range(3e-4, 1e-2, log=True),
        "gae_lambda": Range(0.5, 0.98),
        "num_envs": Choice((192, 384, 512)),
    },
    "ppo-counterfactual": {
        "learning_rate": Range(1e-3, 1e-2, log=True),
        "q_std": Range(0.02, 0.3, log=True),
        "clock_std": Range(0.05, 0.4, log=True),
        "epochs": Choice((2, 3, 5)),
        "num_envs": Choice((16, 32, 64)),
        "within_reach": YES_NO,
    },
    "sac": {
        "nameplate": YES_NO,
        "gamma": GAMMAS,
        "wait": WAITS,
        "learning_rate": Range(1e-4, 3e-3, log=True),
        "entropy_per_action": Range(-4.0, -0.5),
        "gradient_steps": Choice((1, 2, 4)),
        "tau": Range(0.003, 0.03, log=True),
    },
    "td3": {
        "nameplate": YES_NO,
        "gamma": GAMMAS,
        "wait": WAITS,
        "learning_rate": Range(1e-4, 3e-3, log=True),
        "noise": Range(0.03, 0.5, log=True),
        "target_noise": Range(0.03, 0.5, log=True),
        "gradient_steps": Choice((1, 2, 4)),
        "tau": Range(0.003, 0.03, log=True),
    },
    "cem": {
        "std": Range(0.03, 1.0, log=True),
        "extra_std": Range(0.005, 0.1, log=True),
        "elites": Choice((8, 12, 16, 24)),
    },
}
"""Search spaces by algorithm; other settings are those found for the scenario."""


def within(space: Range | Choice, value: Any) -> bool:
    """Whether a value lies in a space."""
    return value in space.values if isinstance(space, Choice) else space.low <= value <= space.high
