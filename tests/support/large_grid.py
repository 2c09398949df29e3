"""Write a grid of 10,000 buses in every format, import each as a user does, and print the seconds.

``python tests/support/large_grid.py``; needs the extras pandapower and power-grid-model.
"""

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from dcgrid_env import Feeder
from dcgrid_env.apps.importers.matpower import write_matpower
from dcgrid_env.apps.importers.pandapower import write_pandapower
from dcgrid_env.apps.importers.power_grid_model import write_power_grid_model

N_BUS = 10_000


def large_feeder(n: int = N_BUS) -> Feeder:
    """A random tree of buses, each with a load, charging and a rating; 3 MW in all."""
    rng = np.random.default_rng(0)
    parent = [0, *(int(rng.integers(max(0, i - 50), i)) for i in range(2, n))]
    buses = [str(i) for i in range(1, n + 1)]
    scale = N_BUS / n
    return Feeder.from_tables(
        name="large",
        base_kv=12.47,
        substation="1",
        v0_pu=1.02,
        bus_ids=buses,
        p_load_kw=[0.0, *(scale * rng.uniform(0, 0.6, n - 1)).tolist()],
        q_load_kvar=[0.0, *(scale * rng.uniform(0, 0.2, n - 1)).tolist()],
        from_bus=[buses[i] for i in parent],
        to_bus=buses[1:],
        r_ohm=rng.uniform(1e-3, 1e-2, n - 1).tolist(),
        x_ohm=rng.uniform(1e-3, 1e-2, n - 1).tolist(),
        rating_a=[400.0] * (n - 1),
        shunt_kw=[0.0] * n,
        shunt_kvar=[0.0, *rng.uniform(0, 0.01, n - 1).tolist()],
    )


def main() -> None:
    """Print the seconds of the clock and of the CPU that each import takes, with its last two lines."""
    with tempfile.TemporaryDirectory() as made:
        folder, feeder = Path(made), large_feeder()
        write_pandapower(feeder, folder / "net.json")
        write_matpower(feeder, folder / "case.m")
        write_power_grid_model(feeder, folder / "grid.json")
        feeder.to_csv(folder / "csv")
        begun = time.perf_counter()
        Feeder.from_csv(folder / "csv")
        print(f"csv, by Feeder.from_csv: {time.perf_counter() - begun:.1f} s")
        for kind, file in (("pandapower", "net.json"), ("matpower", "case.m"), ("power-grid-model", "grid.json")):
            before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
            words = ["import", kind, str(folder / file), "--out", str(folder / kind)]
            command = [sys.executable, "-m", "dcgrid_env.cli", *words]
            said = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            print(f"{kind}: {time.perf_counter() - begun:.1f} s of the clock, {cpu:.1f} s of the CPU")
            print("   ", said[-2][:100])


if __name__ == "__main__":
    main()
