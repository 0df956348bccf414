"""Policies: for every cell and the goals asked for, the probability of each action. NumPy only."""

from cellpilot.policies.base import Policy, greedy_actions
from cellpilot.policies.greedy import GreedyPolicy
from cellpilot.policies.learned import LearnedPolicy, PolicyParameters, load_parameters
from cellpilot.policies.optimal import OptimalPolicy
from cellpilot.policies.uniform import RandomPolicy

__all__ = [
    "GreedyPolicy",
    "LearnedPolicy",
    "OptimalPolicy",
    "Policy",
    "PolicyParameters",
    "RandomPolicy",
    "greedy_actions",
    "load_parameters",
]
