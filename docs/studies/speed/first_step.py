"""Processor time to the first step of an environment with an empty cache of compiled kernels, and with a full one.

Each measurement runs in a separate process. With the interpreter of another version's environment, measurements of both
alternate, so other work on the machine slows both alike.

    python -m docs.studies.speed.first_step ieee33-weak ieee34-3ph
    python -m docs.studies.speed.first_step ieee33-weak --rounds 3 --against ../before/.venv/bin/python
"""

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile

CODE = """
import sys, dcgrid_env
env = dcgrid_env.DcgridEnv(sys.argv[1])
env.reset(seed=0)
env.step(env.action_space.sample())
"""


def user_s(python: str, preset: str, cache: str) -> float:
    """Seconds of processor time that a process takes to make an environment, reset it and step once."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    environment = os.environ | {"NUMBA_CACHE_DIR": cache}
    # In the folder of the cache: that of a clone would be imported in place of what is installed.
    command = [python, "-c", CODE, preset]
    subprocess.run(command, env=environment, cwd=cache, check=True, stderr=subprocess.DEVNULL)
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("presets", nargs="+")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--against", help="interpreter of the environment with another version")
    options = parser.parse_args()
    versions = {"this version": sys.executable} | (
        {"the other": os.path.abspath(options.against)} if options.against else {}
    )
    print("| preset | version | empty cache, s | full cache, s |\n|---|---|---|---|")
    for preset in options.presets:
        found: dict[str, list[tuple[float, float]]] = {name: [] for name in versions}
        for _ in range(options.rounds):
            for name, python in versions.items():
                with tempfile.TemporaryDirectory() as cache:
                    found[name].append((user_s(python, preset, cache), user_s(python, preset, cache)))
        for name, pairs in found.items():
            empty, full = (statistics.median(column) for column in zip(*pairs, strict=True))
            print(f"| `{preset}` | {name} | {empty:.1f} | {full:.1f} |", flush=True)


if __name__ == "__main__":
    main()
