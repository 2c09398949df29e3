"""Control of the feeder's equipment: the taps of its regulators and the switches of its capacitor banks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.checked import inside, pairs, part, refuse, settle
from dcgrid_env.devices.capacitor_bank.capacitor_banks import CapacitorBanks
from dcgrid_env.devices.capacitor_bank.capacitor_control import CapacitorControl
from dcgrid_env.devices.capacitor_bank.threshold_set_points import ThresholdSetPoints
from dcgrid_env.devices.grid_equipment import is_equipment
from dcgrid_env.devices.tap_changer.regulator_control import RegulatorControl
from dcgrid_env.devices.tap_changer.regulator_set_points import RegulatorSetPoints
from dcgrid_env.devices.tap_changer.tap_changers import TapChangers
from dcgrid_env.grid import AnyFeeder, ThreePhaseFeeder
from dcgrid_env.scenario.workload import Background

Decider = Literal["fixed", "controlled", "agent", "setpoint"]
"""Modes: fixed as in the feeder's tables, controlled by the equipment's own control, moved by an agent, or controlled
with set points that an agent chooses."""
ByBank = tuple[tuple[str, Decider], ...]
"""Pairs of a bank and its mode; banks that are not named keep the default."""
DECIDERS: tuple[Decider, ...] = get_args(Decider)
REGULATORS: Decider = "controlled"
CAPACITORS: Decider = "fixed"
_FIXED = {
    "regulators": ("the taps of", "a max_taps_per_move of at least 1 in its regulators.csv"),
    "capacitors": ("the states of", "is_fixed = 0 in its capacitors.csv"),
}
"""What of fixed equipment is fixed, and the column that makes it movable."""


@dataclass(frozen=True, kw_only=True)
class GridControl:
    """Control of regulators and capacitor banks: one mode for all, or a mapping from banks to modes.

    Regulators with a fixed tap (``max_taps_per_move`` 0 in the table) do not move in any mode. The same holds for
    capacitor banks with ``is_fixed`` 1.

    A bank of regulators is identified by the column ``bank`` of its table, a capacitor bank by its name. In a bank of
    regulators in mode ``"agent"``, each tap is a separate agent; in mode ``"setpoint"`` the bank is one. A balanced
    feeder has neither and accepts only the defaults.
    """

    regulators: Decider | ByBank = pairs(default=REGULATORS)
    """Mode of regulators; banks that a mapping does not name are controlled."""
    capacitors: Decider | ByBank = pairs(default=CAPACITORS)
    """Mode of capacitor banks; banks that a mapping does not name are fixed."""
    capacitor_settings: CapacitorControl = part(CapacitorControl)
    """Switching rule of the controlled capacitor banks; settings that a mapping does not name keep their default."""
    regulator_settings: RegulatorControl = part(RegulatorControl)
    """Timers and set points of the controlled regulators; likewise."""

    def __post_init__(self) -> None:
        settle(self)
        for name in ("regulators", "capacitors"):
            value = getattr(self, name)
            modes = value if isinstance(value, tuple) else ((None, value),)
            if not all(isinstance(pair, tuple) and len(pair) == 2 and pair[1] in DECIDERS for pair in modes):
                raise refuse(self, name, f"give one of {', '.join(DECIDERS)}, or a mapping from banks to these")
        measures, capacitors = self.capacitor_settings.measures, self.capacitors
        modes = dict(capacitors).values() if isinstance(capacitors, tuple) else (capacitors,)
        if "setpoint" in modes and measures != "voltage":
            remedy = "for mode 'setpoint' set grid_control.capacitor_settings.measures to 'voltage'"
            raise refuse(self, "capacitors", f"{remedy}, it is {measures!r}")


def regulator_deciders(control: GridControl, feeder: ThreePhaseFeeder) -> tuple[Decider, ...]:
    """Return the mode of each regulator, in the order of its table; a fixed tap stays ``fixed`` in every mode."""
    return _deciders(control.regulators, REGULATORS, *_equipment(feeder)["regulators"])


def capacitor_deciders(control: GridControl, feeder: ThreePhaseFeeder) -> tuple[Decider, ...]:
    """Return the mode of each capacitor bank, in the order of its table; one with ``is_fixed`` stays ``fixed``."""
    return _deciders(control.capacitors, CAPACITORS, *_equipment(feeder)["capacitors"])


def _equipment(feeder: ThreePhaseFeeder) -> dict[str, tuple[Sequence[str], tuple[bool, ...]]]:
    """Names by which modes are given, and whether an element can move, for each row of regulators and capacitors."""
    regulator, capacitor = feeder.network.regulator, feeder.network.capacitor
    is_fixed = capacitor.is_fixed or (0,) * len(capacitor)
    return {
        "regulators": (regulator.bank, tuple(most != 0 for most in regulator.max_taps_per_move)),
        "capacitors": (capacitor.name, tuple(fixed == 0 for fixed in is_fixed)),
    }


def _deciders(value: Any, default: Decider, names: Sequence[str], moves: tuple[bool, ...]) -> tuple[Decider, ...]:
    modes = _by_row(value, names, default)
    return tuple(mode if can_move else "fixed" for mode, can_move in zip(modes, moves, strict=True))


def with_equipment(devices: tuple[Any, ...], control: GridControl, feeder: AnyFeeder) -> tuple[Any, ...]:
    """Return the groups of devices with those of equipment agents last; other groups of these kinds are removed."""
    groups = tuple(device for device in devices if not is_equipment(device))
    if not isinstance(feeder, ThreePhaseFeeder):
        return groups
    by_kind = regulator_deciders(control, feeder), capacitor_deciders(control, feeder)
    for kind, deciders in zip((TapChangers, CapacitorBanks), by_kind, strict=True):
        rows = _rows(deciders, "agent")
        groups += (kind.of_feeder(feeder, rows),) if rows else ()
    of_regulators, of_banks = (_rows(deciders, "setpoint") for deciders in by_kind)
    if of_regulators:
        groups += (RegulatorSetPoints.of_feeder(feeder, of_regulators, control.regulator_settings),)
    if of_banks:
        groups += (ThresholdSetPoints.of_feeder(feeder, of_banks, control.capacitor_settings),)
    return groups


def _rows(deciders: tuple[Decider, ...], decider: Decider) -> tuple[int, ...]:
    return tuple(row for row, of_row in enumerate(deciders) if of_row == decider)


def check_grid_control(control: GridControl, feeder: AnyFeeder, background: Background) -> None:
    """Raise FieldError for a bank that the feeder lacks, or equipment that needs another background."""
    with inside("GridControl", "regulator_settings"):
        _check_offsets(control, feeder, background)
    if not isinstance(feeder, ThreePhaseFeeder) and control.regulator_settings != RegulatorControl():
        remedy = f"the balanced feeder {feeder.name!r} has no regulators that act; leave it out"
        raise refuse(control, "regulator_settings", remedy)
    fixed: dict[str, Any] = {"regulators": REGULATORS, "capacitors": CAPACITORS}
    for name, default in fixed.items():
        value = getattr(control, name)
        if value == default:
            continue
        if not isinstance(feeder, ThreePhaseFeeder):
            raise refuse(control, name, f"the balanced feeder {feeder.name!r} has none that acts; leave it out")
        banks, moves = _equipment(feeder)[name]
        there = dict.fromkeys(banks)
        asked = [bank for bank, _ in value] if isinstance(value, tuple) else list(there)
        for bank in asked:
            if bank not in there:
                raise refuse(
                    control, name, f"feeder {feeder.name!r} has no bank {bank!r}; there are {', '.join(there)}"
                )
        if not there:
            raise refuse(control, name, f"feeder {feeder.name!r} has none; leave it out")
        movable = {bank for bank, can_move in zip(banks, moves, strict=True) if can_move}
        moved = [bank for bank, mode in value if mode != "fixed"] if isinstance(value, tuple) else list(there)
        rigid = [bank for bank in moved if bank not in movable]
        if value != "fixed" and rigid and (isinstance(value, tuple) or not movable):
            what, column = _FIXED[name]
            remedy = f"are fixed in feeder {feeder.name!r}; leave it out, or give {column}"
            raise refuse(control, name, f"{what} {', '.join(rigid)} {remedy}")
        if name == "capacitors" and not background.capacitors:
            raise refuse(control, name, "the background has its capacitors disconnected; connect them or leave it out")


def _check_offsets(control: GridControl, feeder: AnyFeeder, background: Background) -> None:
    """Raise FieldError for the offset of a bank or regulator that the feeder lacks, or a schedule that cannot apply."""
    settings, modes = control.regulator_settings, {}
    if isinstance(feeder, ThreePhaseFeeder):
        table = feeder.network.regulator
        deciders = _by_row(control.regulators, table.bank, REGULATORS)
        modes = dict(zip(table.bank, deciders, strict=True)) | dict(zip(table.name, deciders, strict=True))
    for name, value in settings.offset_v if isinstance(settings.offset_v, tuple) else ():
        remedy = None
        if name not in modes:
            known = ", ".join(modes) or "none"
            remedy = f"feeder {feeder.name!r} has no bank or regulator {name!r}; there are {known}"
        elif isinstance(value, tuple) and background.start_hour is None:
            remedy = "a schedule needs the hour of the day; set background.start_hour"
        elif isinstance(value, tuple) and modes[name] != "controlled":
            remedy = f"a schedule needs a bank in mode 'controlled', {name!r} is in mode {modes[name]!r}; "
            remedy += "give it a number or change grid_control.regulators"
        if remedy:
            raise refuse(settings, "offset_v", remedy)


def _by_row(value: Any, banks: Any, default: Decider) -> tuple[Decider, ...]:
    if isinstance(value, str):
        return (value,) * len(banks)  # pyright: ignore[reportReturnType] (one of the words, checked)
    named = dict(value)
    return tuple(named.get(bank, default) for bank in banks)


def under_own_control(scenario: Any, keep_set_points: bool = False) -> Any:
    """Return the scenario with regulator agents replaced by their banks' control, and capacitor agents by fixed banks.

    Agents of set points are replaced by the control with its default set points, unless ``keep_set_points``. The other
    agents see and do the same as before, and a move costs what it cost. A scenario without such agents is returned
    unchanged.
    """
    return _without_agents(scenario, keep_set_points) or scenario


@cached_on_owner
def _without_agents(scenario: Any, keep_set_points: bool) -> Any:
    feeder, control = scenario.feeder, scenario.grid_control
    if not isinstance(feeder, ThreePhaseFeeder):
        return None
    deciders = regulator_deciders(control, feeder), capacitor_deciders(control, feeder)
    kept: dict[Decider, Decider] = {} if keep_set_points else {"setpoint": "controlled"}
    if not any({"agent", *kept} & set(of_kind) for of_kind in deciders):
        return None
    other = scenario.replace(
        grid_control={
            "regulators": _with_modes(control.regulators, {"agent": "controlled", **kept}),
            "capacitors": _with_modes(control.capacitors, {"agent": "fixed", **kept}),
        }
    )
    left = regulator_deciders(other.grid_control, feeder), capacitor_deciders(other.grid_control, feeder)
    # Switching is charged by the mean over what is not fixed, of which there may now be less.
    switching = scenario.cost.weights.switching * _n_moving(left) / _n_moving(deciders)
    return other.replace(weights=other.cost.weights._replace(switching=switching))


def _with_modes(decider: Decider | ByBank, instead: dict[Decider, Decider]) -> Decider | ByBank:
    if isinstance(decider, str):
        return instead.get(decider, decider)
    return tuple((bank, instead.get(by, by)) for bank, by in decider)


def _n_moving(deciders: tuple[tuple[Decider, ...], ...]) -> int:
    return sum(decider != "fixed" for of_kind in deciders for decider in of_kind)
