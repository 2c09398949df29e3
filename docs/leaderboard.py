"""Make our own entries of the leaderboard, verify them and make its page: `python docs/leaderboard.py`.

`python docs/leaderboard.py ieee33-weak toy6` makes the entries of two presets and the page of all entries. The fresh
episodes of a run begin at one seed, which is drawn after the last entry was submitted. Reports are signed with the key
in $DCGRID_VERIFIER_KEY, by default ~/.config/dcgrid/verifier.key. `--new-key` makes a new one first; reports with
another signature must then be replaced.
"""

import shutil
import sys
from pathlib import Path

from dcgrid_env import PRESETS
from dcgrid_env.agents.leaderboard.page import write_page
from dcgrid_env.agents.leaderboard.signing import NEW_KEY, make_keys, private_key, private_key_file
from dcgrid_env.agents.leaderboard.submitting import submit
from dcgrid_env.agents.leaderboard.verifying import draw_seed, verify
from dcgrid_env.agents.policy.policy import SHIPPED
from dcgrid_env.baselines.score import PUBLISHED_EPISODES

FOLDER, PAGE = Path("docs/leaderboard"), Path("docs/leaderboard.md")
ALGORITHMS = ("analytic", "ppo", "ppo-counterfactual", "safe")
LAWS = {"mpc": "nothing", "model-aided": "nothing", "constant-q-tuned": "validation"}
"""Further controllers, and the split that their parameters were found on."""
LEFT_OUT = {("ieee123-3ph-day", "mpc")}
"""Takes more than two minutes of CPU for 32 episodes, of which an entry needs 96."""


def entries(scenario):
    """Name of each controller of ours on a preset, what names it for `submit`, and what it was learned on."""
    named = [(algorithm, f"{scenario}-{algorithm}", "train") for algorithm in ALGORITHMS]
    laws = [(law, law, split) for law, split in LAWS.items() if (scenario, law) not in LEFT_OUT]
    return [one for one in named if one[1] in SHIPPED] + laws


def submitted(scenario):
    """Write the entries of a preset; their folders."""
    folders = []
    for name, policy, learned_on in entries(scenario):
        folder = FOLDER / f"{scenario}-{name}"
        shutil.rmtree(folder, ignore_errors=True)
        try:
            submit(policy, name, folder, scenario=scenario, episodes=PUBLISHED_EPISODES, learned_on=learned_on)
        except ValueError as error:  # a controller that is not made for the preset's devices
            print(f"{scenario}, {name}: not entered: {error}", flush=True)
            continue
        folders.append(folder)
    return folders


def require_key(is_new):
    """Make a new key, or end with one line unless there is the one of verifier.pub."""
    try:
        if is_new:
            make_keys()
        if private_key() is None:
            sys.exit(f"there is no key in {private_key_file()}; copy the verifier's, or make a new one with {NEW_KEY}")
    except ValueError as error:
        sys.exit(str(error))
    print(f"signed with {private_key_file()}")


if __name__ == "__main__":
    scenarios = [word for word in sys.argv[1:] if word != "--new-key"]
    require_key("--new-key" in sys.argv)
    made = {scenario: submitted(scenario) for scenario in scenarios or PRESETS}
    seed = draw_seed()
    for folders in made.values():
        for folder in folders:
            _, found = verify(folder, seed, fresh=PUBLISHED_EPISODES)
            print(f"{folder}: score {found.score.value:.3f}, J {found.found.J:.4f}", flush=True)
    folders = sorted(path.parent for path in FOLDER.glob("*/submission.json"))
    print(f"wrote {PAGE}: {write_page(folders, PAGE)} entries")
