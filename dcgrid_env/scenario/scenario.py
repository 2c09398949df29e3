"""Scenario: everything that is fixed before an episode is drawn. Frozen; every part checks its fields."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dcgrid_env.core.cache import PickledByFields
from dcgrid_env.core.checked import choice, count, inside, number, parts, refuse, settle
from dcgrid_env.core.coverage import alike
from dcgrid_env.core.seeds import whole_seed
from dcgrid_env.devices import DataCenters, Device, Inverters
from dcgrid_env.devices.faults import CAPACITOR, Fault
from dcgrid_env.devices.ratings import read_only
from dcgrid_env.devices.ride_through.sags import Sag
from dcgrid_env.grid import Feeder, ThreePhaseFeeder
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.grid.reconfigured import reconfigured
from dcgrid_env.scenario.assembly import GROUPS, PARTS, assembled
from dcgrid_env.scenario.cost import Cost
from dcgrid_env.scenario.costs.difference_reward import check_difference_reward
from dcgrid_env.scenario.costs.voltage_reference import check_profile
from dcgrid_env.scenario.errors import ScenarioError, located
from dcgrid_env.scenario.grid_control import GridControl, check_grid_control, with_equipment
from dcgrid_env.scenario.grid_request import GridRequest, check_grid_request
from dcgrid_env.scenario.joint_checks import (
    check_faults,
    check_feeder_kind,
    check_groups,
    check_model,
    check_ramp_limit,
    check_sags,
)
from dcgrid_env.scenario.load_profiles import LoadProfiles, check_load_profiles
from dcgrid_env.scenario.members import grouped
from dcgrid_env.scenario.placement import check_placement, free_load_buses, path_of
from dcgrid_env.scenario.sensing import Sensing
from dcgrid_env.scenario.serialization import feeder_from_data, sags_from_data
from dcgrid_env.scenario.site_recordings import check_trace_scale
from dcgrid_env.scenario.workload import Background, Workload
from dcgrid_env.traces import ALL_SPLITS, WHOLE

PowerFlowName = Literal["distflow", "lindistflow", "sweep"]


@dataclass(frozen=True, eq=False, kw_only=True, init=False)
class Scenario(PickledByFields):
    """One feeder with its devices, load, sensing and cost. Any field can be overridden where an environment is made.

    A part is given as an object, or as a mapping of fields that changes these and leaves the others:
    ``sensing={"noise_pu": 0.005}``. ``datacenters`` and ``inverters`` are given in the same way. A path,
    ``**{"sensing.noise_pu": 0.005}``, is the same; ``assembly.ALIASES`` has short names of common fields. Every field
    also takes plain data, as in JSON and TOML: see ``serialization``.
    """

    name: str
    """Name in files and tables."""
    feeder: Any
    """Feeder, ThreePhaseFeeder or RandomFeeders."""
    source_voltage_pu: float = number(0.5, 1.5)
    """Voltage at the substation, p.u."""
    devices: tuple[Device, ...]
    """Groups of devices; agents are numbered through them in this order. Agents that control
    equipment of the feeder (``grid_control``) come last and are not listed."""
    workload: Workload
    background: Background
    sensing: Sensing
    cost: Cost
    grid_control: GridControl
    grid_request: GridRequest
    load_profiles: LoadProfiles
    faults: tuple[Fault, ...] = parts(Fault)
    """Devices lost in an episode, see :class:`Fault`."""
    sags: tuple[Sag, ...] = parts(Sag)
    """Short sags of the voltage, which devices ride through or not, see :class:`Sag`."""
    horizon: int = count(1, 100_000_000, default=120)
    """Actions in an episode."""
    dt_s: float = number(1e-3, 3600.0, default=1.0)
    """Length of a step, s."""
    power_flow: PowerFlowName = choice("distflow", "lindistflow", "sweep", default="distflow")
    """Power flow solver: "distflow" or "lindistflow" for a balanced feeder, "sweep" for a three-phase one."""
    split: str = choice(*ALL_SPLITS, WHOLE, default="train")
    """train, validation and test share no episode; ood is out of distribution, another GPU or service (generators).
    whole is for answers on the user's files: all hours of load profiles and all of every recording, next to the
    generated load and PV of test."""

    def __init__(self, **arguments: object):
        self._fill(None, arguments)

    def _fill(self, base: Scenario | None, arguments: Mapping[str, Any]) -> None:
        with located(arguments.get("name", getattr(base, "name", None))):
            values = assembled(base, self.__dataclass_fields__, arguments)
            for field in dataclasses.fields(self):
                if field.name not in values and field.default is MISSING:
                    raise TypeError(f"Scenario() missing the keyword argument {field.name!r}")
                object.__setattr__(self, field.name, values.get(field.name, field.default))
            if not isinstance(self.name, str) or not self.name.strip():
                raise refuse(self, "name", "give a text that is not empty")
            settle(self, feeder=feeder_from_data, sags=sags_from_data)
            self._check()

    def _check(self) -> None:
        check_feeder_kind(self)
        check_model(self)
        with inside("Scenario", "grid_control"):
            check_grid_control(self.grid_control, self.feeder, self.background)
        with inside("Scenario", "cost"):
            check_profile(self)
        object.__setattr__(self, "devices", with_equipment(self.devices, self.grid_control, self.feeder))
        check_placement(self.feeder, self.devices)
        check_groups(self.devices, self.horizon, self.dt_s)
        check_ramp_limit(self)
        check_grid_request(self)
        check_load_profiles(self)
        with inside("Scenario", "workload"):
            check_trace_scale(self)
        for device in self.devices:
            with inside("Scenario", path_of(device)):
                device.check_episode(self.horizon)
                if isinstance(device, DataCenters):
                    device.check_step(self.dt_s)
        check_faults(self)
        check_sags(self)
        if self.cost.reward == "difference":
            check_difference_reward(self)

    def __deepcopy__(self, memo: dict[int, Any]) -> Scenario:
        return self  # frozen: a copy of an environment shares it

    def replace(self, **overrides: object) -> Scenario:
        """Return a scenario with other values for the named fields, parts or fields of parts, objects or plain data.

        A mapping changes the fields of a part that it names, and the weights that it names, and leaves the others.

        Raises
        ------
        TypeError
            For a name that is not a field.
        ScenarioError
            For an invalid value.
        """
        other = object.__new__(type(self))
        other._fill(self, overrides)
        return other

    def paid_as_team(self) -> Scenario:
        """Return the scenario with the team's reward for all agents."""
        plain = Cost()
        return self.replace(cost={name: getattr(plain, name) for name in ("reward", "default_action", "default_gains")})

    def member(self, seeds: int | Sequence[int] | np.ndarray) -> Scenario:
        """Return this scenario on the feeder of the first episode of one or more seeds; itself unless on RandomFeeders.

        ScenarioError if the seeds are on different feeders.
        """
        groups = self.members([seeds] if isinstance(seeds, int | np.integer) else seeds)
        if len(groups) != 1:
            how = f"seeds within a multiple of {self.feeder.batch}" if self.split == "train" else "one at a time"
            n = sum(len(positions) for _, positions in groups)
            raise ScenarioError(
                f"scenario {self.name!r}: these {n} episodes are on {len(groups)} feeders, and all must be on one; "
                f"give {how}, or another batch to RandomFeeders"
            )
        return groups[0][0]

    def members(self, seeds: Sequence[int] | np.ndarray) -> list[tuple[Scenario, np.ndarray]]:
        """Return this scenario on each feeder of the seeds' first episodes, with the positions of these seeds."""
        first = np.array([whole_seed(seed) % 2**64 for seed in seeds], np.uint64)
        if not isinstance(self.feeder, RandomFeeders):
            return [(self, np.arange(len(first)))]
        return grouped(self, first, np.zeros_like(first))

    @property
    def family(self) -> Scenario:
        """Return the scenario on RandomFeeders that this is a member of, else itself."""
        return self.__dict__.get("_family", self)

    def to_toml(self, path: str | Path | None = None, base: Scenario | None = None, *, brief: bool = False) -> str:
        """Return the scenario as TOML, and write it if a path is given; ``make_scenario(path)`` reads the file.

        With a ``base``, a preset as ``make_scenario(name)`` gives it, only what differs from it is written, with its
        name; ``brief`` leaves out what is at its default. ScenarioError for another base, or a recording, a feeder or a
        clock law that exists in memory alone.
        """
        from dcgrid_env.scenario.toml import to_toml  # for who writes alone

        return to_toml(self, path, base, brief)

    @property
    def preset(self) -> str | None:
        """Name by which ``make_scenario`` returns this object; None for a variant, or an unpickled one."""
        return self.__dict__.get("_preset")

    @cached_property
    def datacenters(self) -> DataCenters:
        """Group of data centres; empty if there are none."""
        return self.group(DataCenters.kind)

    @cached_property
    def inverters(self) -> Inverters:
        """Group of inverters; empty if there are none."""
        return self.group(Inverters.kind)

    def group(self, kind: str) -> Any:
        """Return the group of devices of a kind."""
        return next(device for device in self.devices if device.kind == kind)

    def difference(self, other: Scenario) -> str | None:
        """Return the path of the first field in which two scenarios differ, or None."""
        kinds = [device.kind for device in self.devices]
        alone = len(kinds) == len(GROUPS) and kinds == [device.kind for device in other.devices]
        parts = (*PARTS, *(GROUPS if alone else ()))
        paths = [name for name in self.__dataclass_fields__ if name not in PARTS and not (alone and name == "devices")]
        paths += (f"{part}.{field.name}" for part in parts for field in dataclasses.fields(getattr(self, part)))
        return next((path for path in paths if not alike(attrgetter(path)(self), attrgetter(path)(other))), None)

    @property
    def generator_split(self) -> str:
        """Split of all that is drawn or generated instead of read from a file: that of ``split``, test for whole."""
        return "test" if self.split == WHOLE else self.split

    @cached_property
    def follows_day(self) -> bool:
        """Whether base load, generated PV and generated requests follow the time of day."""
        by_file = self.load_profiles.file is not None
        return by_file or self.background.start_hour is not None or self.horizon * self.dt_s > 3600.0

    @cached_property
    def agents(self) -> tuple[str, ...]:
        """Agent ids, slots that are the same in every episode: dc_0.., then inv_0.."""
        ids: list[str] = []
        for device in self.devices:
            first = sum(name.startswith(f"{device.prefix}_") for name in ids)
            ids += (f"{device.prefix}_{first + i}" for i in range(device.count))
        return tuple(ids)

    @cached_property
    def n_agents(self) -> int:
        """Number of agents."""
        return len(self.agents)

    @cached_property
    def work_classes(self) -> int:
        """Number of work classes that the clock law distinguishes; 1 without data centres."""
        return max(getattr(device, "work_classes", 1) for device in self.devices)

    @cached_property
    def n_sites(self) -> int:
        """Number of slots that are driven by the workload."""
        return sum(device.count for device in self.devices if device.input == "workload")

    @cached_property
    def site_rated_kw(self) -> np.ndarray:
        """Rating of each slot that is driven by the workload, kW, (n_site,)."""
        return self._of_input("workload", "p_scale_kw")

    @cached_property
    def scheduled_kva(self) -> np.ndarray:
        """Rating of each slot whose injection is scheduled, kVA, (slot,)."""
        return self._of_input("injection", "p_scale_kw")

    @cached_property
    def schedule(self) -> Any:
        """Source of the scheduled injections, see ``Inverters.injection``; None without a schedule."""
        scheduled = [device for device in self.devices if device.input == "injection"]
        return getattr(scheduled[0], "injection", None) if scheduled else None

    @cached_property
    def largest_boost(self) -> float:
        """Highest draw of a site that is driven by the workload, as a share of its rating."""
        groups = [device for device in self.devices if device.input == "workload"]
        shares = [getattr(device, "boost_share", device.largest_draw_share) for device in groups]
        return max(shares, default=1.0)

    def _of_input(self, source: str, field: str) -> np.ndarray:
        parts = [getattr(device, field) for device in self.devices if device.input == source]
        return read_only(np.concatenate([np.empty(0), *parts]))

    @cached_property
    def model(self) -> Any:
        """Balanced feeder as agents and controllers model it; the power flow uses ``feeder``.

        A three-phase feeder is unchanged: the shares then apply to its derivatives, see ``believed_sensitivity``. If
        the model has other switches closed, its buses are in another order, see ``model_position``.
        """
        sensing, feeder = self.sensing, self.feeder
        if not isinstance(feeder, Feeder):
            return feeder
        if sensing.model_open or sensing.model_closed:
            feeder = reconfigured(feeder, sensing.model_open, sensing.model_closed)
        exact = sensing.r_model_share == 1.0 and sensing.x_model_share == 1.0
        return feeder if exact else feeder.scaled(sensing.r_model_share, sensing.x_model_share)

    @cached_property
    def model_position(self) -> np.ndarray:
        """Position in ``model.bus_ids`` of each bus of a balanced ``feeder``, (n_bus,)."""
        return read_only(np.array([self.model.index(bus) for bus in self.feeder.bus_ids]))

    @cached_property
    def q_scale_kvar(self) -> np.ndarray:
        """Reactive limit of each agent at zero active power, kvar, (n_agent,). Reactive actions are shares of it."""
        return read_only(np.concatenate([device.q_limit_kvar for device in self.devices]))

    @cached_property
    def capacitor_connected(self) -> np.ndarray:
        """1 where a capacitor is connected at t = 0, by bus, or by bank on a three-phase feeder; 0 elsewhere."""
        feeder = self.feeder
        there = feeder.base_capacitor_on if isinstance(feeder, ThreePhaseFeeder) else feeder.capacitor_kvar > 0
        return read_only(np.where(self.background.capacitors, there, 0.0))

    @cached_property
    def fault_targets(self) -> tuple[np.ndarray, ...]:
        """Candidates of each fault: an agent's position, or n_agents + the position of a capacitor's bus."""
        drawn_from = []
        for fault in self.faults:
            targets: list[int] = []
            for name in fault.among:
                targets += [self.agents.index(name)] if name in self.agents else self._of_kind(name)
            drawn_from.append(np.unique(targets))
        return tuple(map(read_only, drawn_from))

    def _of_kind(self, kind: str) -> list[int]:
        if kind == CAPACITOR:
            connected = self.capacitor_connected > 0
            return [self.n_agents + int(bus) for bus in np.flatnonzero(connected)]
        kinds = [device.kind for device in self.devices for _ in range(device.count)]
        return [i for i, of_agent in enumerate(kinds) if of_agent == kind]

    @cached_property
    def candidates(self) -> np.ndarray:
        """Positions in ``bus_ids`` where a device may be drawn: load buses without a fixed one."""
        return read_only(free_load_buses(self.feeder, self.devices))
