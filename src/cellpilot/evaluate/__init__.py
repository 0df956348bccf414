"""Evaluation: the same start-goal pairs for every policy, all of them exactly or a sample with intervals."""

from cellpilot.evaluate.evaluation import Evaluation, evaluate_policies
from cellpilot.evaluate.metrics import METRICS
from cellpilot.evaluate.mobility import HandoverRule

__all__ = ["METRICS", "Evaluation", "HandoverRule", "evaluate_policies"]
