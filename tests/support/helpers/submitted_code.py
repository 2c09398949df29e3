"""Code of a submitter in processes of the leaderboard, on `toy6`."""

import textwrap

import numpy as np
import pytest

from dcgrid_env.agents.leaderboard import confinement, remote
from dcgrid_env.agents.leaderboard.running import TUNED, scenario_of
from dcgrid_env.agents.leaderboard.scopes import Scope

confines = pytest.mark.skipif(not confinement.version(), reason="this system has no Landlock")

ACTING = """
import ctypes, errno, fcntl, mmap, os, resource, socket, subprocess, sys, threading
import numpy as np
seen = []
libc = ctypes.CDLL(None, use_errno=True)

def called(result):
    "The result of a call of the C library, or its error."
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result

class Own:
    def reset(self, env_info):
        self.agents = env_info.agents

    def act(self, observations):
        {body}
        return np.zeros((len(observations), 4))
"""


def acted(body, scope="joint", confined=False):
    """Actions of code on two equal observations of toy6, whose values are the numbers of their columns."""
    scenario = scenario_of("toy6")
    code = ACTING.format(body=textwrap.indent(body, 8 * " ").lstrip()).encode()
    with remote.remote("controller.py:Own", scenario, TUNED, Scope.parse(scope), code, confined) as controller:
        controller.reset(scenario)
        return controller.act(np.tile(np.arange(23.0, dtype=np.float32), (2, 1)))


ATTACKING = """
allowed = []
for attack in {attacks!r}:
    try:
        exec(attack)
        allowed.append(attack)
    except OSError as error:
        if error.errno not in {numbers}:
            allowed.append(f"{{attack}}: {{error}}")
if allowed:
    raise LookupError(f"{{len(allowed)}} not refused: {{allowed}}")
"""


def require_refused(attacks, *numbers):
    """Run attacks in one confined process; ProcessError with those that do not end in an error of these numbers."""
    acted(ATTACKING.format(attacks=list(attacks), numbers=numbers), confined=True)
