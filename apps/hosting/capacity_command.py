"""The command ``dcgrid capacity``."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from dcgrid_env.cli.own_feeder import FeederRequest, scenario_on_feeder
from dcgrid_env.core.commands.names import split_names
from dcgrid_env.core.commands.progress import progress_bar
from dcgrid_env.core.commands.settings import Overrides, check_folder
from dcgrid_env.core.commands.terminal import plain_console, say
from dcgrid_env.core.commands.workers import OverWorkers
from dcgrid_env.core.files import write_figure, write_json, write_text
from dcgrid_env.core.versions import meta

if TYPE_CHECKING:
    from dcgrid_env import Scenario
    from dcgrid_env.apps.hosting.capacity_study import Study
    from dcgrid_env.apps.hosting.hosting import Capacities

Controllers = Annotated[str, tyro.conf.arg(aliases=("--controller",))]


@dataclass(frozen=True)
class Capacity(OverWorkers):
    """Find the largest data centre that each bus can carry.

    This is the hosting capacity of the feeder under each controller.

    The command adds one data centre at one bus at a time and simulates it in windows of sampled load. It searches for
    the largest size that keeps every bus within the voltage limits and every branch within its rating, if known. It
    prints a table of capacity and work delay, and writes capacity.csv, results.json and capacity.png, a map of the
    feeder coloured by MW.
    """

    feeder: str | None = None
    """Feeder: a folder, for example from dcgrid import, or the name of a bundled feeder. Default: the feeder of
    --scenario. Without --scenario, the added site is the only device. The source voltage is that of the feeder's file;
    bundled feeders that leave the band without any site have one that centres the voltages."""
    scenario: str | None = None
    """Scenario that defines the other devices, and the trace and type of the added site: a name (dcgrid list),
    path/to/file.toml or path/to/file.py:function."""
    set: Overrides = ()
    """Scenario fields to override, for example --set source_voltage_pu=1.05 datacenters.s_rated_share=1.1. The
    value source_voltage_pu=centred chooses a voltage that centres those of the buses."""
    controllers: Controllers = "none,droop-tuned"
    """Controllers, separated by commas, as for dcgrid run. A tuned law without gains for the scenario uses its default
    gains. A policy acts on the observations of the site."""
    buses: str | None = None
    """Candidate buses, separated by commas, or all. Default: up to 64 load buses, evenly spread."""
    samples: int = 64
    """Number of windows of sampled load, with seeds 0, 1, ... All sizes, buses and controllers use the same windows.
    Windows at the worst hours are added."""
    load: Literal["day", "peak"] = "day"
    """Level of the other loads: day spreads the samples over all hours of the load profiles, or of a standard day;
    peak keeps the feeder's nominal load."""
    trace: str | None = None
    """Trace of all data centres instead of the scenario's: a generator or a recording (dcgrid list)."""
    window_s: float = 60.0
    """Length of a window, s."""
    settle_s: float = 20.0
    """Start of each window in which limits are not checked while controllers settle, s."""
    limits: str = "0.95,1.05"
    """Lowest and highest voltage, p.u., separated by a comma."""
    loading_max_pct: float = 100.0
    """Largest branch current, % of its rating. Branches without a rating are not checked."""
    rating: Literal["normal", "emergency"] = "normal"
    """Ratings that apply: normal, or emergency of the feeder's ratings.csv."""
    season: str = ""
    """Season of the ratings in the feeder's ratings.csv, for example winter. Default: the ratings without a season."""
    outage_rating: Literal["normal", "emergency"] | None = None
    """Ratings that apply with an element of --outages out of service. Default: those of --rating."""
    voltage_step_max_pct: float | None = None
    """Largest change of any voltage within a step, % of nominal voltage, for example 3. Default: no limit."""
    taps_max_per_hour: float | None = None
    """Largest number of taps of a regulator per hour. Default: no limit."""
    loss_max_kw: float | None = None
    """Largest mean loss of a window, kW. Default: no limit."""
    outages: str = ""
    """Also find the capacity with one element out of service, for each of a list, separated by commas: all, or for
    example 'capacitor c83, regulator reg4, open sw4 + close sw7'."""
    together: Literal["equal", "sum"] | None = None
    """Also find the sizes that sites at all --buses can have at once: equal shares as far as possible, or the largest
    sum. Requires at least two buses."""
    allowed_pct: float = 0.0
    """Share of the seconds of all windows in which a limit may be violated, %. Above 0, a result may exceed the
    snapshot."""
    tolerance_mw: float | None = None
    """Step between sizes, MW. Default: a round number near one thousandth of the largest size."""
    max_mw: float | None = None
    """Largest size to try, MW. Default: about three times the feeder's load."""
    tuned: Path | None = None
    """File with the gains of the tuned controllers, written by dcgrid tune."""
    allow: str = ""
    """unverified: go on with an imported feeder whose voltages are not those of the program that it comes from."""
    out: Path = Path("results/capacity")
    """Folder for capacity.csv, capacity.png and results.json. Created if missing."""

    def run(self) -> None:
        """Search, print and write; raise ValueError before writing if a setting is invalid."""
        from dcgrid_env.apps.hosting.added_site import AddedSite
        from dcgrid_env.apps.hosting.capacity_maps import capacity_maps
        from dcgrid_env.apps.hosting.capacity_output import (
            capacity_csv,
            capacity_table,
            outages_csv,
            outages_table,
            record,
            together_table,
        )
        from dcgrid_env.apps.hosting.hosting import hosting_capacity, study_controller
        from dcgrid_env.apps.hosting.outages import outages_asked
        from dcgrid_env.apps.hosting.sites_together import sites_together
        from dcgrid_env.baselines.engineering import file_lines
        from dcgrid_env.baselines.scenario_spec import voltage_line
        from dcgrid_env.baselines.tuning.tuned import require_tuned

        place, names = self.place, split_names(self.controllers)
        if not names:
            raise ValueError(f"controllers: must name at least one controller (dcgrid list), got {self.controllers!r}")
        require_tuned(self.tuned)
        study = _study(self)
        outages = outages_asked(study.scenario, split_names(self.outages))
        if self.outage_rating is not None and not outages:
            raise ValueError(
                f"outage_rating: is {self.outage_rating!r} without --outages; name outages or leave it out"
            )
        if self.together is not None and (self.buses is None or len(study.candidates()) < 2):
            raise ValueError(f"together: needs at least two buses in --buses, got {self.buses!r}")
        check_folder(self.out)
        console = plain_console()
        with progress_bar(console) as progress:
            total = len(study.candidates()) * (1 + len(outages))
            tasks = {name: progress.add_task(name, total=total) for name in names}

            def capacities(variant: Study) -> Capacities:
                return hosting_capacity(
                    variant, names, place, self.tuned, lambda name, n: progress.advance(tasks[name], n)
                )

            result = capacities(study)
            by_outage = {name: capacities(study.with_outage(changed)) for name, changed in outages.items()}
            at_once = []
            if self.together is not None:
                task = progress.add_task("together", total=None)
                for name in names:
                    controller, _ = study_controller(name, study.scenario, self.tuned)
                    at_once.append(
                        sites_together(study, controller, name, self.together, lambda: progress.advance(task))
                    )
        source = voltage_line(study.scenario, self.set, self.scenario)
        say(console, source)
        tables = [capacity_table(result)]
        tables += [outages_table(result, by_outage)] if by_outage else []
        tables += [together_table(at_once)] if at_once else []
        for table in tables:
            console.print(table.rich(console.width))
            for note in table.notes:
                console.print(note)
        for line in file_lines(AddedSite(study, result.windows).scenario(0)):
            console.print(line)
        figure = capacity_maps(result)  # before anything is written
        write_text(self.out / "capacity.csv", capacity_csv(result))
        written = ["capacity.csv", "results.json", "capacity.png"]
        if by_outage:
            write_text(self.out / "outages.csv", outages_csv(by_outage))
            written.insert(1, "outages.csv")
        more = {"together": [asdict(one) for one in at_once]} if at_once else {}
        write_json(self.out / "results.json", {"meta": meta(), "source_voltage": source, **record(result), **more})
        write_figure(self.out / "capacity.png", figure, dpi=130)
        paths = [str(self.out / name) for name in written]
        say(console, f"wrote {', '.join(paths[:-1])} and {paths[-1]}")


def _study(cfg: Capacity) -> Study:
    from dcgrid_env.apps.hosting.capacity_study import Study

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
        rating=cfg.rating,
        season=cfg.season,
        outage_rating=cfg.outage_rating,
        voltage_step_max_pct=cfg.voltage_step_max_pct,
        taps_max_per_hour=cfg.taps_max_per_hour,
        loss_max_kw=cfg.loss_max_kw,
        allowed_pct=cfg.allowed_pct,
        tolerance_mw=cfg.tolerance_mw,
        max_mw=cfg.max_mw,
    )


def _scenario(cfg: Capacity) -> Scenario:
    from dcgrid_env.baselines.engineering import engineering_scenario
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec

    chosen: dict[str, Any] = {} if cfg.trace is None else {"trace": cfg.trace}
    feeder, scenario = cfg.feeder, cfg.scenario
    if feeder is not None:
        return engineering_scenario(
            lambda split: scenario_on_feeder(FeederRequest(feeder, scenario), cfg.set, split, chosen)
        )
    if scenario is None:
        raise ValueError("feeder: must be given, or --scenario; pass --feeder with a feeder's name or folder")
    return engineering_scenario(lambda split: ScenarioSpec(scenario, cfg.set).make(split, **chosen))


def _limits(text: str) -> tuple[float, float]:
    try:
        low, high = map(float, text.split(","))
    except ValueError:
        raise ValueError(
            f"limits: must be the lowest and the highest voltage, such as 0.95,1.05, got {text!r}"
        ) from None
    return low, high
