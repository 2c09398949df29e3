"""The command ``dcgrid capacity``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from dcgrid_env.cli.names import split_names
from dcgrid_env.cli.own_feeder import Asked, scenario_on_feeder
from dcgrid_env.cli.progress import progress_bar
from dcgrid_env.cli.settings import Overrides, check_folder
from dcgrid_env.cli.terminal import plain_console, say
from dcgrid_env.cli.workers import OverWorkers
from dcgrid_env.core.files import write_figure, write_json, write_text
from dcgrid_env.core.versions import meta

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dcgrid_env import Scenario
    from dcgrid_env.baselines.hosting_capacity.capacity_study import Study
    from dcgrid_env.baselines.hosting_capacity.hosting import Capacities

Controllers = Annotated[str, tyro.conf.arg(aliases=("--controller",))]


@dataclass(frozen=True)
class Capacity(OverWorkers):
    """Find the largest data centre that each bus can carry.

    This is the hosting capacity of the feeder, under each controller.

    One data centre is added at one bus at a time, in ever other sizes, and run through windows of sampled load; a size
    carries if every bus keeps within the limits of voltage, and every branch of known rating within that. Beside the MW
    stands what they cost: the delay of the site's work. Prints a table and writes capacity.csv, capacity.png, a map of
    the feeder coloured by MW, and results.json.
    """

    feeder: str | None = None
    """The feeder: its folder (what dcgrid import writes, for instance), or the name of one that ships. The added site
    is alone on it, at a source voltage that centres the band unless --set source_voltage_pu says which, if --scenario
    does not say what else is there. Without it the feeder is that of the scenario."""
    scenario: str | None = None
    """Name of a scenario (dcgrid list), path/to/file.toml, or path/to/file.py:function, whose devices stand beside the
    added site, and whose trace and kind of site it has."""
    set: Overrides = ()
    """Fields of the scenario to change, for instance --set source_voltage_pu=1.05 datacenters.s_rated_share=1.1."""
    controllers: Controllers = "none,droop-tuned"
    """Controllers separated by commas, as dcgrid run takes them. A tuned law without gains for the scenario has its
    defaults; a policy acts on what the site observes."""
    buses: str | None = None
    """Candidate buses separated by commas, or all; by default load buses, 64 at most, spread evenly."""
    samples: int = 64
    """Windows of sampled load: those of seeds 0, 1, .., the same for all sizes, buses and controllers."""
    load: Literal["day", "peak"] = "day"
    """Level of the other loads: day spreads the samples over the hours of a day, from the peak's on; peak holds the
    feeder's nominal load."""
    trace: str | None = None
    """Work of the added site, and of others, instead of the scenario's: a generator (dcgrid list) or a recording."""
    window_s: float = 60.0
    """Length of a window, s."""
    settle_s: float = 20.0
    """Its first seconds, in which limits do not count as controllers only begin."""
    limits: str = "0.95,1.05"
    """Lowest and highest voltage, p.u., with a comma between."""
    loading_max_pct: float = 100.0
    """Largest current of a branch, % of its rating, where that is known."""
    allowed_pct: float = 0.0
    """Share of the seconds in which some limit may be broken, %."""
    tolerance_mw: float | None = None
    """Distance between sizes, MW; by default a round number near a thousandth of the largest."""
    max_mw: float | None = None
    """Largest size to try, MW; by default some three times the feeder's load."""
    split: str = "test"
    """Which windows the seeds mean: train, validation, test, or ood."""
    tuned: Path | None = None
    """File of dcgrid tune that the gains of tuned controllers must come from."""
    out: Path = Path("results/capacity")
    """Folder for capacity.csv, capacity.png and results.json; made if it is not there."""

    def run(self) -> None:
        """Search, print, write. ValueError for an invalid setting, before anything is written."""
        from dcgrid_env.baselines.hosting_capacity.capacity_output import capacity_csv, capacity_table, record
        from dcgrid_env.baselines.hosting_capacity.hosting import hosting_capacity
        from dcgrid_env.baselines.tuning.tuned import require_tuned

        place, names = self.place, split_names(self.controllers)
        if not names:
            raise ValueError(f"controllers is {self.controllers!r}; name at least one (dcgrid list)")
        require_tuned(self.tuned)
        study = _study(self)
        check_folder(self.out)
        console = plain_console()
        with progress_bar(console) as progress:
            total = len(study.candidates())
            tasks = {name: progress.add_task(name, total=total) for name in names}
            found = hosting_capacity(study, names, place, self.tuned, lambda name, n: progress.advance(tasks[name], n))
        table = capacity_table(found)
        console.print(table.rich(console.width))
        for note in table.notes:
            console.print(note)
        figure = draw(found)  # before anything is written
        write_text(self.out / "capacity.csv", capacity_csv(found))
        write_json(self.out / "results.json", {"meta": meta(), **record(found)})
        write_figure(self.out / "capacity.png", figure, dpi=130)
        say(console, f"wrote {self.out / 'capacity.csv'}, {self.out / 'results.json'} and {self.out / 'capacity.png'}")


def _study(cfg: Capacity) -> Study:
    from dcgrid_env.baselines.hosting_capacity.capacity_study import Study

    scenario = _scenario(cfg)
    buses = None
    if cfg.buses is not None:
        ids = scenario.feeder.bus_ids
        buses = tuple(map(str, ids[1:])) if cfg.buses.strip() == "all" else tuple(split_names(cfg.buses))
    low, high = _limits(cfg.limits)
    return Study(
        scenario=scenario,
        others=cfg.scenario is not None,
        buses=buses,
        samples=cfg.samples,
        load=cfg.load,
        window_s=cfg.window_s,
        settle_s=cfg.settle_s,
        v_min_pu=low,
        v_max_pu=high,
        loading_max_pct=cfg.loading_max_pct,
        allowed_pct=cfg.allowed_pct,
        tolerance_mw=cfg.tolerance_mw,
        max_mw=cfg.max_mw,
    )


def _scenario(cfg: Capacity) -> Scenario:
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec

    chosen: dict[str, Any] = {} if cfg.trace is None else {"trace": cfg.trace}
    if cfg.feeder is not None:
        return scenario_on_feeder(Asked(cfg.feeder, cfg.scenario), cfg.set, cfg.split, chosen)
    if cfg.scenario is None:
        raise ValueError("feeder is missing; give --feeder, a feeder's name or folder, or --scenario")
    return ScenarioSpec(cfg.scenario, cfg.set).make(cfg.split, **chosen)


def _limits(text: str) -> tuple[float, float]:
    try:
        low, high = map(float, text.split(","))
    except ValueError:
        raise ValueError(f"limits is {text!r}; give the lowest and the highest voltage, such as 0.95,1.05") from None
    return low, high


def draw(found: Capacities) -> Figure:
    """A map for each controller, all on one scale."""
    import numpy as np

    from dcgrid_env.rendering.capacity_map import capacity_figure

    feeder = found.study.scenario.feeder
    maps = {}
    for name in found.controllers:
        mw = np.full(feeder.n_bus, np.nan)
        mw[[feeder.index(bus) for bus in found.buses]] = [c.capacity_mw for c in found.by_controller[name]]
        maps[name] = mw
    limits = f"{found.study.v_min_pu:g} to {found.study.v_max_pu:g} p.u."
    return capacity_figure(feeder, maps, f"{feeder.name}: largest data centre at a bus within {limits}")
