"""Peak memory and steps a second of long episodes, kept whole and in parts: one line, see docs/long-episodes.md.

python -m docs.studies.speed.long_episodes HORIZON EPISODES whole|parts
"""

import resource
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from dcgrid_env import ParquetCourse, make_scenario
from dcgrid_env.baselines import make_controller, rollout, streaming_rollout
from dcgrid_env.engine.exogenous.trace_pool import check_traces


def main(horizon: int, episodes: int, how: str) -> None:
    """Run the droop law on ieee33-weak and print what it took; time is that of the processor, traces left out."""
    scenario = make_scenario("ieee33-weak", split="test", horizon=horizon)
    controller, seeds = make_controller("droop", scenario), range(episodes)
    short = scenario.replace(horizon=60)
    rollout(short, controller, seeds).metrics()  # compiles
    check_traces(scenario)
    size = 0
    begun = time.process_time()
    if how == "whole":
        j = rollout(scenario, controller, seeds).metrics()[0]["J"]
    else:
        with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
            course = stack.enter_context(ParquetCourse(Path(folder), scenario, seeds))
            j = streaming_rollout(scenario, controller, seeds, [course]).metrics()[0]["J"]
            stack.close()
            size = course.bytes_written
    took_s = time.process_time() - begun
    peak_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(
        f"{horizon} steps x {episodes}, {how}: {horizon / took_s:.0f} steps/s of CPU, peak {peak_mib:.0f} MiB, "
        f"Parquet {size / 1e6:.1f} MB, J of the first {j!r}"
    )


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3])
