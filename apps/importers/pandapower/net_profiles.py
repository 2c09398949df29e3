"""Load profiles of a pandapower net, in the form of SimBench: ``net.profiles`` and the column ``profile``.

SimBench multiplies each load by the columns PROFILE_pload and PROFILE_qload of ``net.profiles["load"]``, and the active
power of each generator and storage by the column PROFILE of ``net.profiles["renewables"]`` and ``["storage"]`` [1]_. A
feeder has one load for each bus, so the profiles are summed: kW and kvar of each bus with a profile, all its loads,
generators and storages included.

References
----------
.. [1] S. Meinecke et al., "SimBench: A benchmark dataset of electric power systems to compare innovative solutions
   based on power flow analysis", Energies 13(12):3290, 2020.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.grid.topology import FeederError
from dcgrid_env.traces import ProfileTable, TraceError
from dcgrid_env.traces.profile_file import REACTIVE, date_seconds
from dcgrid_env.traces.profile_table import checked_table

STEP_S = 900.0
"""Time between two samples of SimBench's profiles, which counts where ``net.profiles`` has no times, s."""
_DIGITS = 6
"""Digits of kW and kvar behind the decimal point."""


class NetProfiles:
    """Profiles of a net by its buses, read before the net is reduced to a feeder."""

    def __init__(self, called: str, net: Any, report: Report):
        self.changes: dict[Any, tuple[np.ndarray, np.ndarray]] = {}
        """Bus of the net, and what its loads, generators and storages draw beyond their present power, kW and kvar,
        (sample,)."""
        self._called, self._times = called, None
        profiles = net.get("profiles")
        if not isinstance(profiles, dict):
            return
        for kind, table, sign in (("load", "load", 1.0), ("sgen", "renewables", -1.0), ("storage", "storage", 1.0)):
            profile_table = profiles.get(table)
            if profile_table is None or "profile" not in net[kind].columns or not len(profile_table):
                continue
            self._add(net, kind, profile_table, sign, report)

    def _add(self, net: Any, kind: str, profile_table: Any, sign: float, report: Report) -> None:
        elements = net[kind]
        z_shares = [c for c in ("const_z_p_percent", "const_z_q_percent") if kind == "load" and c in elements]
        live = elements.in_service.to_numpy(dtype=bool) & elements.bus.map(net.bus.in_service).to_numpy(dtype=bool)
        for i, row in elements[live].iterrows():
            name = row["profile"]
            if name is None or name != name or not str(name).strip():
                continue
            p_name, q_name = (f"{name}_pload", f"{name}_qload") if kind == "load" else (str(name), None)
            if p_name not in profile_table.columns:
                raise FeederError(
                    f"{self._called}: {kind} {i} has the profile {name!r}, but net.profiles has no column {p_name!r}"
                )
            if any(row[column] for column in z_shares):
                text = "its profile is left out: it has a share of constant impedance"
                report.add("nothing lost", kind, str(i), text)
                continue
            scale = 1000.0 * sign * float(row["scaling"])
            p_share = _column(self._called, profile_table, p_name) - 1.0
            q_share = 0.0 * p_share
            if q_name in profile_table.columns:
                q_share = _column(self._called, profile_table, str(q_name)) - 1.0
            p, q = self.changes.get(row["bus"], (0.0, 0.0))
            try:
                p = p + scale * float(row["p_mw"]) * p_share
                q = q + scale * float(row["q_mvar"]) * q_share
            except ValueError:
                raise FeederError(f"{self._called}: the tables of net.profiles differ in length") from None
            self.changes[row["bus"]] = (p, q)
            report.add("taken", f"profile of {kind}", str(i), "in load_profiles.csv, summed by bus")
        if "time" in profile_table.columns and self._times is None:
            self._times = [str(time) for time in profile_table["time"]]

    def table(self, buses: dict[Any, str], loads: dict[str, tuple[float, float]]) -> ProfileTable | None:
        """Return kW and kvar of each bus of the feeder with a profile; None if there are none.

        Parameters
        ----------
        buses
            Bus of the feeder for each bus of the net that is supplied.
        loads
            Present load of each bus of the feeder, kW and kvar.
        """
        of_bus: dict[str, list[np.ndarray]] = {}
        for bus, (p, q) in self.changes.items():
            if bus in buses:
                name = buses[bus]
                before = of_bus.get(name) or [np.array(v) for v in loads.get(name, (0.0, 0.0))]
                of_bus[name] = [before[0] + p, before[1] + q]
        if not of_bus:
            return None
        columns = {name: p for name, (p, _) in of_bus.items()}
        columns |= {f"{name}{REACTIVE}": q for name, (_, q) in of_bus.items()}
        file = f"{self._called}: net.profiles"
        values = np.column_stack([*columns.values()]).round(_DIGITS)
        try:
            times_s, day = STEP_S * np.arange(len(values)), ""
            if self._times is not None:
                times_s, day = date_seconds(file, self._times)
            return checked_table(
                file, times_s, [*columns], values, lambda i: f"row {i}", lambda i, j: values[i, j], day
            )
        except TraceError as error:
            raise FeederError(str(error)) from None


def _column(called: str, profile_table: Any, name: str) -> np.ndarray:
    try:
        values = profile_table[name].to_numpy(dtype=float)
    except (TypeError, ValueError):
        values = np.array([np.nan])
    if not np.isfinite(values).all():
        raise FeederError(f"{called}: net.profiles, column {name!r} has a value that is no finite number; repair it")
    return values
