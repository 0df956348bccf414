"""Solvers over a world and a task: exact values by value iteration, policy iteration and cheapest paths. NumPy and SciPy only."""

from cellpilot.solve.values import LARGE_CELLS, goals_solved_at_once, optimal_values

__all__ = ["LARGE_CELLS", "goals_solved_at_once", "optimal_values"]
