"""A three-phase feeder's own tables as a circuit of OpenDSS, to check figures and speed against.

The library comes with the extras ``bench`` and ``test`` and is imported when a circuit is made.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dcgrid_env import ThreePhaseFeeder

_NODES = {"a": 1, "b": 2, "c": 3}
_WIRES = {"wye": (".1", ".2", ".3"), "delta": (".1.2", ".2.3", ".3.1")}
_MODELS = {"PQ": 1, "Z": 2, "CVR": 4, "I": 5, "ZIP": 8}
TOLERANCE = 1e-10
"""Default convergence tolerance of OpenDSS, p.u. of voltage."""


def _wires(phases: str) -> str:
    return "".join(f".{_NODES[p]}" for p in phases)


def _matrix(values: Any, phases: str) -> str:
    at = ["abc".index(p) for p in phases]
    return "[" + " | ".join(" ".join(repr(float(values[i][j])) for j in at) for i in at) + "]"


class OpenDss:
    """One circuit, with or without a load for each device's leg; ``solve`` hands over voltages and totals."""

    def __init__(self, feeder: ThreePhaseFeeder, tolerance: float = TOLERANCE, has_devices: bool = True):
        from dss import DSS  # pyright: ignore[reportMissingImports]  (in the bench and test extras only)

        self.dss, self.feeder, network = DSS.NewContext(), feeder, feeder.network
        self._n_leg = feeder.n_leg if has_devices else feeder.first_device_leg
        text = self.dss.Text
        for line in ("Clear", *self._source(network), *self._branches(network), *self._injections(network)):
            text.Command = line
        bases = sorted({round(float(kv) * math.sqrt(3.0), 9) for kv in feeder.base_kv_ln})
        text.Command = f"Set VoltageBases={bases}"
        text.Command = "CalcVoltageBases"
        for line in (f"Set Tolerance={tolerance}", "Set MaxIterations=300", "Set ControlMode=OFF", "Set Mode=Snap"):
            text.Command = line
        self._names = [str(n).lower() for n in self.dss.ActiveCircuit.AllNodeNames]
        of_node = {name: k for k, name in enumerate(self._names)}
        wanted = [
            f"{feeder.bus_ids[bus].lower()}.{phase}"
            for bus, phase in zip(feeder.node_bus, feeder.node_phase, strict=True)
        ]
        self._order = [of_node[name] for name in wanted]

    def _source(self, network: Any) -> list[str]:
        source = network.source
        z = np.array(source.r_ohm[0]) + 1j * np.array(source.x_ohm[0])
        z1, z0 = complex(z[0, 0] - z[0, 1]), complex(z[0, 0] + 2.0 * z[0, 1])
        return [
            f"New Circuit.{self.feeder.name.replace('-', '_')} bus1={source.bus[0]} basekv={source.base_kv[0]!r} "
            f"pu={source.v_pu[0]!r} angle={source.angle_deg[0]!r} phases=3 "
            f"Z1=[{z1.real!r}, {z1.imag!r}] Z0=[{z0.real!r}, {z0.imag!r}]"
        ]

    def _branches(self, network: Any) -> list[str]:
        out, line, switch = [], network.phase_line, network.switch
        for k, name in enumerate(line.name):
            phases = line.phases[k]
            nf = np.array(line.b_us[k]) * 1e3 / (2.0 * math.pi * network.frequency_hz)
            out.append(
                f"New Line.{name} bus1={line.from_bus[k]}{_wires(phases)} bus2={line.to_bus[k]}{_wires(phases)} "
                f"phases={len(phases)} length=1 rmatrix={_matrix(line.r_ohm[k], phases)} "
                f"xmatrix={_matrix(line.x_ohm[k], phases)} cmatrix={_matrix(nf, phases)}"
            )
        for k, name in enumerate(switch.name):
            if switch.state[k] == "closed":
                phases, r, x = switch.phases[k], switch.r_ohm[k] * np.eye(3), switch.x_ohm[k] * np.eye(3)
                wires = _wires(phases)
                out.append(
                    f"New Line.{name} bus1={switch.from_bus[k]}{wires} bus2={switch.to_bus[k]}{wires} "
                    f"phases={len(phases)} length=1 rmatrix={_matrix(r, phases)} xmatrix={_matrix(x, phases)} "
                    f"cmatrix={_matrix(np.zeros((3, 3)), phases)}"
                )
        return out + self._transformers(network.transformer) + self._regulators(network.regulator)

    @staticmethod
    def _transformers(table: Any) -> list[str]:
        out = []
        for k, name in enumerate(table.name):
            r, conn = table.r_percent[k] / 2.0, ("delta", "wye")
            sides = [conn[0] if c == "delta" else conn[1] for c in (table.connection_from[k], table.connection_to[k])]
            out.append(
                f"New Transformer.{name} phases={len(table.phases[k])} windings=2 buses=[{table.from_bus[k]}"
                f"{_wires(table.phases[k])} {table.to_bus[k]}{_wires(table.phases[k])}] conns=[{sides[0]} {sides[1]}] "
                f"kvs=[{table.kv_ll_from[k]!r} {table.kv_ll_to[k]!r}] kvas=[{table.kva[k]!r} {table.kva[k]!r}] "
                f"%Rs=[{r!r} {r!r}] xhl={table.x_percent[k]!r} ppm_antifloat={table.antifloat_ppm[k]!r} "
                f"leadlag={'lead' if table.shift_deg[k] > 0 else 'lag'} %noloadloss=0 %imag=0"
            )
        return out

    @staticmethod
    def _regulators(table: Any) -> list[str]:
        out = []
        for k, name in enumerate(table.name):
            r, phases, wires = table.r_percent[k] / 2.0, len(table.phases[k]), _wires(table.phases[k])
            kv, kva = table.kv_ln[k] * (math.sqrt(3.0) if phases > 1 else 1.0), table.kva_per_phase[k] * phases
            out.append(
                f"New Transformer.{name} phases={phases} windings=2 buses=[{table.from_bus[k]}{wires} "
                f"{table.to_bus[k]}{wires}] conns=[wye wye] kvs=[{kv!r} {kv!r}] kvas=[{kva!r} {kva!r}] "
                f"%Rs=[{r!r} {r!r}] xhl={table.x_percent[k]!r} ppm_antifloat={table.antifloat_ppm[k]!r} "
                "%noloadloss=0 %imag=0 maxtap=1.2 mintap=0.8"
            )
        return out

    def _injections(self, network: Any) -> list[str]:
        feeder, out = self.feeder, []
        table, legs = network.phase_load, feeder.load_legs
        for leg, row in enumerate(legs.row):
            bus, node, other = feeder.bus_ids[legs.bus[leg]], feeder.node_phase[legs.node[leg]], legs.other[leg]
            wires = f".{node}" if other < 0 else f".{node}.{feeder.node_phase[other]}"
            shares = f" zipv=[{' '.join(map(str, (*table.zip[row], 0.0)))}]" if table.zip[row] else ""
            out.append(
                f"New Load.leg{leg} bus1={bus}{wires} phases=1 conn={table.connection[row]} "
                f"kv={table.leg_kv[row]!r} kw=0 kvar=0 model={_MODELS[table.model[row]]} "
                f"vminpu={table.vmin_pu[row]!r} vmaxpu={table.vmax_pu[row]!r} vlowpu={table.vlow_pu[row]!r}{shares}"
            )
        for node in range(self._n_leg - feeder.first_device_leg):
            bus = feeder.node_bus[node]
            out.append(
                f"New Load.device{node} bus1={feeder.bus_ids[bus]}.{feeder.node_phase[node]} phases=1 conn=wye "
                f"kv={float(feeder.base_kv_ln[bus])!r} kw=0 kvar=0 model=1 vminpu=0.01 vmaxpu=9 vlowpu=0.001"
            )
        capacitors = feeder.capacitor_legs
        for leg, row in enumerate(capacitors.row):
            node, other = feeder.node_phase[capacitors.node[leg]], capacitors.other[leg]
            wires = f".{node}" if other < 0 else f".{node}.{feeder.node_phase[other]}"
            out.append(
                f"New Capacitor.leg{leg} bus1={feeder.bus_ids[capacitors.bus[leg]]}{wires} phases=1 "
                f"kv={network.capacitor.leg_kv[row]!r} kvar={-float(capacitors.q_kvar[leg])!r} "
                f"conn={network.capacitor.connection[row]}"
            )
        cores = feeder.core_legs
        for leg, row in enumerate(cores.row):
            node, other = feeder.node_phase[cores.node[leg]], cores.other[leg]
            ends = (f"{node}", "0" if other < 0 else f"{feeder.node_phase[other]}")
            bus1, bus2 = (f"{feeder.bus_ids[cores.bus[leg]]}.{end}" for end in ends)
            for kind, power in (("r", cores.p_kw[leg]), ("x", cores.q_kvar[leg])):
                if power:
                    ohm = network.core.leg_kv[row] ** 2 * 1000.0 / float(power)
                    r, x = (ohm, 0.0) if kind == "r" else (0.0, ohm)
                    out.append(f"New Reactor.core{leg}{kind} bus1={bus1} bus2={bus2} phases=1 r={r!r} x={x!r}")
        return out

    def set_point(self, p_kw: Any, q_kvar: Any, source_pu: float, tap_ratio: Any, state: Any) -> None:
        """Set every input, without a solution."""
        circuit, feeder = self.dss.ActiveCircuit, self.feeder
        circuit.Vsources.Name = "source"
        circuit.Vsources.pu = float(source_pu)
        loads, first = circuit.Loads, feeder.first_device_leg
        for leg in range(self._n_leg):
            loads.Name = f"leg{leg}" if leg < first else f"device{leg - first}"
            loads.kW, loads.kvar = float(p_kw[leg]), float(q_kvar[leg])
        for row, name in enumerate(feeder.network.regulator.name):
            circuit.Transformers.Name = name
            circuit.Transformers.Wdg = 2
            circuit.Transformers.Tap = float(tap_ratio[row])
        for leg, row in enumerate(feeder.capacitor_legs.row):
            circuit.Capacitors.Name = f"leg{leg}"
            circuit.Capacitors.States = [int(state[row])]  # pyright: ignore[reportAttributeAccessIssue]

    def solve_again(self) -> None:
        """Solve what is set, from the voltages of the last solution; RuntimeError without one."""
        solution = self.dss.ActiveCircuit.Solution
        solution.Solve()
        if not solution.Converged:
            raise RuntimeError(f"OpenDSS found no power flow on feeder {self.feeder.name!r}")

    def solve(self, *point: Any) -> tuple[np.ndarray, float, float, float]:
        """Complex voltages, p.u., by node, loss and source power, kW and kvar; RuntimeError without a solution."""
        self.set_point(*point)
        self.solve_again()
        circuit, feeder = self.dss.ActiveCircuit, self.feeder
        volts = np.array(circuit.AllBusVolts).view(np.complex128)[self._order]
        power = np.array(circuit.TotalPower)[:2]
        loss = np.array(circuit.Losses).ravel()[0] / 1e3
        v_pu = volts / (1e3 * feeder.base_kv_ln[feeder.node_bus])
        return v_pu, float(loss) + self._core_loss_kw(v_pu), -float(power[0]), -float(power[1])

    def _core_loss_kw(self, v_pu: np.ndarray) -> float:
        """Power of the cores, which are reactors to ground here: OpenDSS does not count it as a loss."""
        cores, v = self.feeder.core_legs, np.append(v_pu, 0.0)  # the last for ground, whose index is -1
        return float((cores.p_kw * np.abs((v[cores.node] - v[cores.other]) / cores.rated_pu) ** 2).sum())
