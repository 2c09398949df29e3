"""Learned policies: their files, finding and scoring them, and one training algorithm a file.

Importing the package, or running a policy, needs no torch; the algorithms and ``sb3_vec_env`` import it themselves.
"""

from dcgrid_env.agents.from_sb3.sb3_policy import UnknownNormalisationWarning, to_policy
from dcgrid_env.agents.policy.card import Card
from dcgrid_env.agents.policy.guard import GuardedPolicy, guarded
from dcgrid_env.agents.policy.model_aided_policy import ModelAidedPolicy
from dcgrid_env.agents.policy.neural_network import Network, PolicyError
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.policy.unseen import UnseenScenarioWarning
from dcgrid_env.agents.row_policy import RowPolicy
from dcgrid_env.agents.training.row_networks import policy_of_rows
from dcgrid_env.agents.training.sb3_settings import ppo_settings, sac_settings, td3_settings
from dcgrid_env.agents.training.training_env import training_env
from dcgrid_env.agents.training.vec_env import sb3_vec_env
from dcgrid_env.baselines import find_controller
from dcgrid_env.baselines.evaluation import Evaluation, evaluate

__all__ = [
    "Card",
    "Evaluation",
    "GuardedPolicy",
    "ModelAidedPolicy",
    "Network",
    "Policy",
    "PolicyError",
    "RowPolicy",
    "UnknownNormalisationWarning",
    "UnseenScenarioWarning",
    "evaluate",
    "find_controller",
    "guarded",
    "policy_of_rows",
    "ppo_settings",
    "sac_settings",
    "sb3_vec_env",
    "td3_settings",
    "to_policy",
    "training_env",
]
