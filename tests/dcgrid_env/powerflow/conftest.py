"""What the power-flow tests share: loads, small feeders, and the same feeder in pandapower."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch

from dcgrid_env import Feeder, Solution, load_feeder
from dcgrid_env.powerflow.balanced import implicit, prefix
from helpers.feeders import BALANCED


@pytest.fixture(params=BALANCED)
def feeder(request: pytest.FixtureRequest) -> Feeder:
    """Each of the named feeders."""
    return load_feeder(request.param)


@pytest.fixture
def toy6() -> Feeder:
    return load_feeder("toy6")


@pytest.fixture
def base(toy6: Feeder) -> tuple[np.ndarray, np.ndarray]:
    """toy6's base load, writable."""
    return toy6.p_load_kw.copy(), toy6.q_load_kvar.copy()


@pytest.fixture
def random_loads() -> Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Loads p, q (row, bus) and substation voltages (row,) that every named feeder can carry.

    Every third row also feeds in, a half of the feeder's load at a random bus and negative loads elsewhere, so that
    power flows back.
    """

    def draw(feeder: Feeder, n_row: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rng = np.random.default_rng(seed)
        back = np.arange(n_row) % 3 == 2
        p_kw = feeder.p_load_kw * rng.uniform(0.0, 1.6, (n_row, feeder.n_bus))
        p_kw = np.where(back[:, None], p_kw - 1.2 * feeder.p_load_kw * rng.random((n_row, feeder.n_bus)), p_kw)
        q_kvar = feeder.q_load_kvar * rng.uniform(-0.5, 1.6, (n_row, feeder.n_bus))
        q_kvar = q_kvar - feeder.capacitor_kvar * rng.integers(0, 2, (n_row, 1))
        p_kw[back, rng.integers(1, feeder.n_bus, back.sum())] -= 0.5 * feeder.p_load_kw.sum()
        return p_kw, q_kvar, rng.uniform(0.97, 1.06, n_row)

    return draw


@pytest.fixture
def two_bus() -> Callable[..., Feeder]:
    """Two buses 1 - 2, 1 kV, so that ohm is per unit."""

    def build(r_ohm: float, x_ohm: float) -> Feeder:
        return Feeder.from_tables(
            name="two", base_kv=1.0, substation=1, v0_pu=1.0, bus_ids=[1, 2], p_load_kw=[0.0, 0.0],
            q_load_kvar=[0.0, 0.0], from_bus=[1], to_bus=[2], r_ohm=[r_ohm], x_ohm=[x_ohm],
        )  # fmt: skip

    return build


@pytest.fixture
def as_numpy() -> Callable[[Solution], Solution]:
    """A solution in torch tensors as one in NumPy arrays."""
    return lambda solution: Solution(*(a.detach().numpy() for a in solution))


@pytest.fixture
def as_torch() -> Callable[..., Any]:
    """Arrays as tensors, which share nothing with them."""
    return lambda *arrays: tuple(torch.tensor(np.asarray(a)) for a in arrays)


@pytest.fixture
def by_arrays(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Called, it has tensors on the CPU solved as those of other devices are, by array operations."""
    return lambda: monkeypatch.setattr(implicit, "distflow_tensors", prefix.distflow_arrays)


@pytest.fixture
def torch_warns_always() -> Iterator[None]:
    """torch warns once a process, which would make what a test sees depend on the tests before it."""
    before = torch.is_warn_always_enabled()
    torch.set_warn_always(True)
    yield
    torch.set_warn_always(before)


class PandapowerNet:
    """One feeder as a pandapower network: Newton's method on bus admittances, which shares nothing with DistFlow.

    A branch without impedance becomes a closed bus-bus switch, which pandapower fuses: exact as well.
    """

    def __init__(self, feeder: Feeder):
        import pandapower

        self._run: Any = pandapower.runpp
        self.net = net = pandapower.create_empty_network(sn_mva=1.0)
        for bus in feeder.bus_ids:
            pandapower.create_bus(net, vn_kv=feeder.base_kv, name=str(bus))
        pandapower.create_ext_grid(net, 0)
        for k, (i, j) in enumerate(zip(feeder.from_bus.tolist(), feeder.to_bus.tolist(), strict=True)):
            if feeder.r_ohm[k] == 0.0 and feeder.x_ohm[k] == 0.0:
                pandapower.create_switch(net, i, j, et="b", closed=True)
            else:
                pandapower.create_line_from_parameters(
                    net, i, j, length_km=1.0, r_ohm_per_km=float(feeder.r_ohm[k]),
                    x_ohm_per_km=float(feeder.x_ohm[k]), c_nf_per_km=0.0, max_i_ka=1.0,
                )  # fmt: skip
        for bus in range(feeder.n_bus):
            pandapower.create_load(net, bus, p_mw=0.0, q_mvar=0.0)

    def solve(self, p_kw: np.ndarray, q_kvar: np.ndarray, v0_pu: float) -> dict[str, Any]:
        """Bus voltages, loss and what the substation imports, in the units of ``Solution``."""
        net = self.net
        net.load["p_mw"] = p_kw / 1000.0
        net.load["q_mvar"] = q_kvar / 1000.0
        net.ext_grid["vm_pu"] = v0_pu
        # 1e-8 MVA: the branch of 1e-5 ohm in khodr141 leaves Newton's mismatch no lower than some 1e-9.
        self._run(net, algorithm="nr", init="flat", tolerance_mva=1e-8, max_iteration=50, numba=False)
        imported = net.res_ext_grid.iloc[0]
        return {
            "v_pu": net.res_bus.vm_pu.to_numpy(),
            "loss_kw": 1000.0 * float(net.res_line.pl_mw.sum()),
            "p_import_kw": 1000.0 * float(imported.p_mw),
            "q_import_kvar": 1000.0 * float(imported.q_mvar),
        }


@pytest.fixture(scope="session")
def pandapower_net() -> Callable[[Feeder], PandapowerNet]:
    """The network of a feeder, made once."""
    nets: dict[str, PandapowerNet] = {}
    return lambda feeder: nets.get(feeder.name) or nets.setdefault(feeder.name, PandapowerNet(feeder))
