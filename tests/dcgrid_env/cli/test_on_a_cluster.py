"""Commands on a Ray cluster of a head and two nodes, of which one is killed: nothing is lost, all figures are the same.

The cluster's workers have another working directory than the commands, and so see none of the files that these name.
"""

import json
import os
import re
import signal
import subprocess
import sys
import time
from importlib.util import find_spec

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.agents import Network, Policy
from helpers.places import ROOT
from helpers.ray_cluster import QUIET, ray_cluster

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("ray") is None, reason="the extra ray is not installed"),
    pytest.mark.skipif(not os.path.isdir("/proc"), reason="finds the processes of a node in /proc"),
]

UNITS_OF_25 = int(os.environ.get("DCGRID_RAY_UNITS", "300"))
"""Units of 25 episodes of the longest run."""

OWN = """
import time
import numpy as np
import shares

class Slow:
    def reset(self, env_info):
        self.n = 2 * env_info.datacenters.count + env_info.inverters.count

    def act(self, observations):
        time.sleep(0.03)
        return np.full((len(observations), self.n), shares.HALF)
"""


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    with ray_cluster(tmp_path_factory.mktemp("elsewhere")) as started:
        yield started


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def begun(*words, module="dcgrid_env.cli.main"):
    command = [sys.executable, "-m", module, *words]
    environment = os.environ | QUIET | {"PYTHONPATH": os.pathsep.join([os.getcwd(), str(ROOT)])}
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment)


def ended(process):
    said = process.communicate(timeout=300)[0]
    assert "Traceback" not in said
    assert "raylet" not in said
    return process.returncode, said


def waited_for(pattern, folder, process):
    until = time.monotonic() + 240.0
    while not list(folder.glob(pattern)):
        assert process.poll() is None, process.communicate()[0]
        assert time.monotonic() < until
        time.sleep(0.05)


def test_a_benchmark_survives_ctrl_c_and_a_killed_node(here, cluster):
    """Its scenario, law and policy are named by relative paths, which mean nothing to the workers."""
    (here / "own.py").write_text(OWN)
    (here / "shares.py").write_text("HALF = 0.5\n")
    (here / "mine.toml").write_text(make_scenario("toy6", horizon=60).replace(name="mine").to_toml())
    half = {"datacenter": Network([(np.zeros((9, 2)), [0.5] * 2)]), "inverter": Network([(np.zeros((7, 1)), [0.5])])}
    Policy(half).save("half")
    words = ["benchmark", "--scenarios", "toy6,mine.toml", "--controllers", "none,own.py:Slow,half.safetensors"]
    words += ["--episodes", "75"]
    assert ended(begun(*words, "--workers", "1", "--out", "local"))[0] == 0
    on_ray = [*words, "--ray", cluster.address, "--out", "ray"]

    process = begun(*on_ray)
    waited_for("ray/units/*/*/*.json", here, process)
    process.send_signal(signal.SIGINT)
    code, said = ended(process)
    assert (code, "interrupted with" in said) == (130, True)
    kept = {path: path.read_bytes() for path in here.glob("ray/units/*/*/*.json")}
    assert kept

    process = begun(*on_ray)
    waited = time.monotonic() + 240.0
    while len(list(here.glob("ray/units/*/*/*.json"))) <= len(kept) and time.monotonic() < waited:
        time.sleep(0.05)
    assert process.poll() is None
    assert cluster.kill_node()  # its workers
    code, said = ended(process)
    assert code == 0, said
    assert "units with these settings are already in" in said
    assert all(path.read_bytes() == content for path, content in kept.items())
    local, ray = (json.loads((here / out / "results.json").read_text()) for out in ("local", "ray"))
    assert len(local["episodes"]) == 75 * 7
    for part in ("episodes", "summaries", "failures"):
        assert local[part] == ray[part]
    cluster.add_node()


def test_many_units_survive_three_killed_nodes(here, cluster):
    (here / "short.toml").write_text(make_scenario("toy6", horizon=5).replace(name="short").to_toml())
    words = ["benchmark", "--scenarios", "short.toml", "--controllers", "none", "--episodes", str(25 * UNITS_OF_25)]
    assert ended(begun(*words, "--workers", "2", "--out", "local"))[0] == 0
    process = begun(*words, "--ray", cluster.address, "--out", "ray")
    units = here / "ray" / "units"
    until = time.monotonic() + 600.0
    for share in (0.1, 0.4, 0.7):
        while len(list(units.glob("*/*/*.json"))) < share * UNITS_OF_25:
            assert process.poll() is None, process.communicate()[0]
            assert time.monotonic() < until
            time.sleep(0.05)
        assert process.poll() is None
        assert cluster.kill_node()
        cluster.add_node()
    code, said = ended(process)
    assert code == 0, said
    assert len(list(units.glob("*/*/*.json"))) == UNITS_OF_25
    local, ray = (json.loads((here / out / "results.json").read_text()) for out in ("local", "ray"))
    for part in ("episodes", "summaries", "failures"):
        assert local[part] == ray[part]


def test_a_training_over_seeds_survives_a_killed_node(here, cluster):
    words = ["train", "analytic", "--scenario", "toy6", "--set", "horizon=20", "--seeds", "4", "--updates", "40"]
    words += ["--num-envs", "8", "--validation-episodes", "2", "--hidden", "4"]
    assert ended(begun(*words, "--workers", "1", "--out", "local"))[0] == 0
    process = begun(*words, "--ray", cluster.address, "--out", "ray")
    waited_for("ray/seed-*/policy.json", here, process)
    assert cluster.kill_node()
    code, said = ended(process)
    assert code == 0, said
    for seed in range(4):
        local, ray = (here / out / f"seed-{seed}" for out in ("local", "ray"))
        assert (local / "policy.safetensors").read_bytes() == (ray / "policy.safetensors").read_bytes()
        assert json.loads((ray / "config.json").read_text())["out"] == f"ray/seed-{seed}"
        a, b = (json.loads((one / "policy.json").read_text()) for one in (local, ray))
        assert a["validation_J"] == b["validation_J"]
        assert b["command"] == a["command"].replace("local", "ray")
        assert not list(ray.glob(".*"))
    cluster.add_node()


def test_tuning_hindsight_capacity_studies_and_searches_come_to_the_same(here, cluster):
    (here / "mine.toml").write_text(make_scenario("toy6", horizon=12).replace(name="mine").to_toml())
    few = ("--scenarios", "mine.toml", "--episodes", "2")
    site = ("--scenario", "mine.toml", "--samples", "2", "--window-s", "10", "--settle-s", "4", "--max-mw", "4")
    commands = {
        "tuned.json": ("tune", "--laws", "droop-q", *few, "--out", "{}/tuned.json"),
        "mine.json": ("hindsight", *few, "--out", "{}"),
        "capacity.csv": ("capacity", *site, "--controllers", "none,droop-tuned", "--out", "{}"),
        "unseen-feeders.md": ("unseen-feeders", "--scenarios", "toy6", "--episodes", "2", "--out", "{}"),
        "reproduction.json": ("reproduce", "--episodes", "2", "--trace", "generated", "--out", "{}"),
    }
    for name, words in commands.items():
        module = "docs.studies" if name == "unseen-feeders.md" else "dcgrid_env.cli.main"
        for out, where in (("local", ("--workers", "1")), ("ray", ("--ray", cluster.address))):
            code, said = ended(begun(*(word.format(out) for word in words), *where, module=module))
            assert code == 0, said
    for name in commands:
        local, ray = ((here / out / name).read_text() for out in ("local", "ray"))
        if name.endswith(".json"):
            part = {"tuned.json": "laws", "reproduction.json": "claims"}.get(name, "episodes")
            local, ray = (json.loads(text)[part] for text in (local, ray))
        if name.endswith(".md"):
            local, ray = ([line for line in text.splitlines() if "docs.studies" not in line] for text in (local, ray))
        assert local == ray
        assert local


UNITS = """
import json, os, signal, sys
from dcgrid_env.core.work import cluster as work
from dcgrid_env.core.work.unit import Lost, Unit

def killed_at_first(item):
    from dcgrid_env.core.work.unit import shared
    path, deaths = item
    with open(path, "a") as file:
        file.write("x")
    tries = os.path.getsize(path)
    if tries <= deaths:
        os.kill(os.getpid(), signal.SIGKILL)
    if deaths == 0:
        raise ValueError("no good")
    return [tries, shared("added"), os.environ["OMP_NUM_THREADS"], os.environ["DCGRID_NUM_THREADS"]]

place = work.cluster(sys.argv[1])
units = [Unit(f"unit {i}", killed_at_first, (f"{sys.argv[2]}/{i}", i)) for i in (0, 1, 4)]
results = {unit.key: result for unit, result in place.run(units, {"added": 7})}
print(json.dumps({key: [r.reason] if isinstance(r, Lost) else r for key, r in results.items()}))
work._software()["numpy"] = "9.9"  # here, and not on the nodes
((_, refused),) = place.run(units[:1])
print(refused.reason)
"""


def test_units_whose_workers_die_are_repeated_by_ray_and_nodes_of_other_code_refused(here, cluster):
    (here / "units.py").write_text(UNITS)
    process = subprocess.run(
        [sys.executable, "units.py", cluster.address, str(here)],
        env=os.environ | QUIET, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    found, refused = process.stdout.splitlines()
    found = json.loads(found)
    assert found["unit 0"] == ["no good"]
    assert found["unit 1"] == [2, 7, "1", "1"]
    assert "worker died" in found["unit 4"][0]
    assert (here / "4").stat().st_size == 4
    assert re.fullmatch(r"ImportError: ray: node \S+ has numpy \S+, not 9.9; install the same on all nodes", refused)
