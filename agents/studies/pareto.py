"""The front of voltage against delay: policies trained under a limit on mean delay, over the droop law's curve."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dcgrid_env.agents.studies.learning_tables import HEADINGS, Table, commands, figures, page, wrapped
from dcgrid_env.agents.studies.scored import Scored, controller_on_test, on_test, scored
from dcgrid_env.agents.studies.training_runs import command, folder, trained
from dcgrid_env.baselines import Droop
from dcgrid_env.baselines.score import REFERENCE
from dcgrid_env.baselines.tuning.tuned import tuned_parameters

K_P_MW_PER_PU = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 14.0, 20.0)
"""Active gains of the droop law's curve; the paper's Table I has 1, 10 and 20."""
PAPERS_ALPHA_PER_S, BETWEEN_PER_S = 0.3, 0.03
VALIDATION_EPISODES = 100
"""To select a policy on: a mean delay hangs on a few heavy episodes."""
POINTS = ("mpc-one-step",)
"""Other controllers beside the curves: what the model of the whole feeder buys."""


@dataclass(frozen=True)
class Learned:
    """Policies of one limit, one for each training seed."""

    limit_s: float | None
    """None: waiting is priced as the scenario has it."""
    tested: Scored
    command: str
    """Command of the first seed's training."""

    @property
    def label(self) -> str:
        """What tables call it."""
        return "none, J as it is" if self.limit_s is None else f"{self.limit_s:g} s"


@dataclass(frozen=True)
class Swept:
    """The droop law, its active gain swept, at one share of the backlog asked back for."""

    alpha_per_s: float
    tuned: bool
    """Whether alpha is the tuned one."""
    k_p_mw_per_pu: tuple[float, ...]
    tested: tuple[Scored, ...]


@dataclass(frozen=True)
class Front:
    """All that is drawn."""

    scenario: str
    episodes: int
    learned: tuple[Learned, ...]
    swept: tuple[Swept, ...]
    points: dict[str, Scored]
    """Single controllers by name, the tuned droop first."""


def configs(algorithm: type[Any], scenario: str, limits_s: Sequence[float], chosen: dict[str, Any], seeds: int,
            runs: Path) -> list[Any]:  # fmt: skip
    """A run for each limit, and one without, and each seed; ``chosen`` are further settings of the training."""
    placed = []
    for limit_s in (*limits_s, None):
        label = "no-limit" if limit_s is None else f"delay-{limit_s:g}"
        for seed in range(seeds):
            one = algorithm(
                scenario=scenario, seed=seed, delay_limit_s=limit_s, validation_episodes=VALIDATION_EPISODES, **chosen
            )
            placed.append(_placed(one, runs, label))
    return placed


def _placed(config: Any, runs: Path, label: str) -> Any:
    return dataclasses.replace(config, out=folder(runs, config.scenario, label, config.updates, config.seed))


def front(scenario: str, episodes: int, configs: Sequence[Any]) -> Front:
    """Test the policies of finished runs, and the laws beside them."""
    by_limit: dict[float | None, list[Any]] = {}
    for config in configs:
        by_limit.setdefault(config.delay_limit_s, []).append(config)
    learned = tuple(
        Learned(limit_s, scored([trained(one)[0] for one in every], scenario, episodes), command(every[0]))
        for limit_s, every in by_limit.items()
    )
    points = {name: controller_on_test(name, scenario, episodes) for name in (REFERENCE, *POINTS)}
    return Front(scenario, episodes, learned, swept(scenario, episodes), points)


def swept(scenario: str, episodes: int) -> tuple[Swept, ...]:
    """The droop law's curves: all gains as tuned but k_p, and then alpha too, which decides what k_p costs in delay."""
    tuned = tuned_parameters("droop", on_test(scenario)).parameters
    curves: list[Swept] = []
    for alpha in dict.fromkeys((float(tuned["alpha_per_s"]), BETWEEN_PER_S, PAPERS_ALPHA_PER_S)):
        gains: list[dict[str, Any]] = [tuned | {"k_p_mw_per_pu": k_p, "alpha_per_s": alpha} for k_p in K_P_MW_PER_PU]
        tested = tuple(scored([Droop(**gain)], scenario, episodes) for gain in gains)
        curves.append(Swept(alpha, alpha == tuned["alpha_per_s"], K_P_MW_PER_PU, tested))
    return tuple(curves)


def learned_table(front: Front) -> Table:
    """The learned front."""
    n = len(front.learned[0].tested.each) if front.learned else 0
    rows = [(one.label, *figures(one.tested.mean.means), _delays(one.tested)) for one in front.learned]
    rows += [(name, *figures(tested.mean.means), "") for name, tested in front.points.items()]
    title = (
        f"{front.scenario}: {front.episodes} test episodes, means over episodes and {n} training seed{'s' * (n > 1)}"
    )
    return Table(title, ("limit on mean delay", *HEADINGS, "mean delay of each seed, s"), tuple(rows))


def _delays(tested: Scored) -> str:
    return ", ".join(f"{one.means['delay_mean_s']:.2f}" for one in tested.each)


def droop_table(front: Front) -> Table:
    """The droop law's curves."""
    rows = [
        (f"{curve.alpha_per_s:g}{' (tuned)' if curve.tuned else ''}", f"{k_p:g}", *figures(tested.mean.means))
        for curve in front.swept
        for k_p, tested in zip(curve.k_p_mw_per_pu, curve.tested, strict=True)
    ]
    return Table("The droop law, k_p swept", ("alpha, 1/s", "k_p, MW/p.u.", *HEADINGS), tuple(rows))


def markdown(front: Front, made_by: str, image: str) -> str:
    """The page."""
    about = (
        "Each policy is trained for the least cost but for waiting, at no more than so much mean delay; the price of "
        "waiting is found while it is trained (a multiplier that rises while the limit is exceeded on the training "
        "split), and the policy kept is the best on the validation split. Here they are on the test split, which "
        "neither has seen, so the delay need not be the limit exactly. The last one has no limit, but the scenario's "
        "own price of waiting."
    )
    under = (
        "Under it the droop law as tuned but for its active gain k_p, and for alpha, the share of the backlog that is "
        f"asked back for in a second: the tuned one, {BETWEEN_PER_S:g}, and the paper's {PAPERS_ALPHA_PER_S:g}. "
        "The one-step predictive control knows the feeder and all that happens on it; the policies see what a bus sees."
    )
    each = commands("Each run of the first seed by itself:", ((one.label, one.command) for one in front.learned))
    parts = (wrapped(about), wrapped(under), f"![{front.scenario}: voltage against delay]({image})")
    return page("Voltage against delay", made_by, *parts, learned_table(front).markdown(), each,
                droop_table(front).markdown())  # fmt: skip
