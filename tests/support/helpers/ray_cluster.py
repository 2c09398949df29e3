"""A Ray cluster on this machine, in processes of its own: a head without cores, and nodes of one core each."""

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

SCRIPT = """
import sys
from ray.cluster_utils import Cluster

cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
print(cluster.address, flush=True)
for line in sys.stdin:
    node = cluster.add_node(num_cpus=1, wait=True)
    print(*(process.process.pid for of_kind in node.all_processes.values() for process in of_kind), flush=True)
cluster.shutdown()
"""
QUIET = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0", "RAY_AUTH_MODE": "disabled"}


class RayCluster:
    """Its address, and the processes of its nodes."""

    def __init__(self, process):
        self.process = process
        self.address = self._said()
        self.nodes: list[int] = []

    def _said(self):
        """The next line that is the script's own; Ray may say things besides."""
        for line in self.process.stdout:
            if line.strip() and all(part.replace(".", "").replace(":", "").isdigit() for part in line.split()):
                return line.strip()
        raise AssertionError("the cluster has ended")

    def add_node(self):
        """Start another node."""
        self.process.stdin.write("add\n")
        self.process.stdin.flush()
        self.nodes.append(int(self._said()))

    def kill_node(self):
        """Kill the newest node: its raylet and all workers that this has started, by their ids."""
        raylet = self.nodes.pop()
        children = [
            int(pid) for path in Path(f"/proc/{raylet}/task").glob("*/children") for pid in path.read_text().split()
        ]
        for pid in (raylet, *children):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        return children


@contextlib.contextmanager
def ray_cluster(folder):
    """A cluster of a head and two nodes, whose workers' working directory is ``folder``."""
    with subprocess.Popen(
        [sys.executable, "-c", SCRIPT],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        text=True, cwd=folder, env=os.environ | QUIET,
    ) as process:  # fmt: skip
        try:
            cluster = RayCluster(process)
            for _ in range(2):
                cluster.add_node()
            yield cluster
        finally:
            assert process.stdin is not None
            process.stdin.close()
            try:
                process.wait(30)
            except subprocess.TimeoutExpired:
                process.kill()
