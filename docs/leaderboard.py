"""Make our own entries of the leaderboard, verify them and make its page: `python docs/leaderboard.py`.

Policies' entries that still stand, those that ship having the weights that were verified, are left as they are; laws,
by which no such change is seen, are run anew. `python docs/leaderboard.py ieee33-weak toy6` makes the entries of two
presets, and the page of all that stand.
"""

import shutil
import sys
import time
from pathlib import Path

from dcgrid_env.agents.leaderboard.entry_files import SubmissionError
from dcgrid_env.agents.leaderboard.page import listed, write_page
from dcgrid_env.agents.leaderboard.submitting import submit
from dcgrid_env.agents.leaderboard.verifying import verify
from dcgrid_env.agents.policy.policy import SHIPPED
from dcgrid_env.baselines.rollout import ControllerError

FOLDER, PAGE = Path("docs/leaderboard"), Path("docs/leaderboard.md")
SCENARIOS = ("toy6", "ieee123", "ieee33-weak", "ieee33", "das69", "khodr141", "mixed", "fault")
ALGORITHMS = ("analytic", "ppo", "ppo-counterfactual", "safe")
LAWS = {"model-aided": "nothing", "constant-q-tuned": "validation"}
"""Laws that stand beside the policies, and the split that their parameters were found on."""


def entries(scenario):
    """Name of each controller of ours on a preset, what names it for `submit`, and what it was learned on."""
    named = [(algorithm, f"{scenario}-{algorithm}", "train") for algorithm in ALGORITHMS]
    return [one for one in named if one[1] in SHIPPED] + [(law, law, split) for law, split in LAWS.items()]


def stands(folder):
    """Whether an entry was verified and nothing has changed since."""
    try:
        return bool(listed(folder))
    except SubmissionError:
        return False


def make(scenario):
    """The entries of a preset that do not stand yet, and those of laws."""
    began_s = time.process_time()
    for name, policy, learned_on in entries(scenario):
        folder = FOLDER / f"{scenario}-{name}"
        if name not in LAWS and stands(folder):
            continue
        shutil.rmtree(folder, ignore_errors=True)
        try:
            submit(policy, name, folder, scenario=scenario, learned_on=learned_on)
        except ControllerError as error:  # a law that is not made for the preset's devices
            print(f"{scenario}: {error}")
            continue
        _, found = verify(folder)
        print(f"{folder}: score {found.score.value:.3f}, J {found.found.J:.4f}", flush=True)
    print(f"{scenario}: {time.process_time() - began_s:.0f} s of CPU", flush=True)


if __name__ == "__main__":
    for scenario in sys.argv[1:] or SCENARIOS:
        make(scenario)
    folders = sorted(path.parent for path in FOLDER.glob("*/submission.json"))
    print(f"wrote {PAGE}: {write_page(folders, PAGE)} entries")
