"""Cheapest paths to a goal, where every step costs: Dijkstra backwards from the goals."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from cellpilot.airspace import MOVED
from cellpilot.grid import IntArray
from cellpilot.task import Task
from cellpilot.world import World


def least_cost(world: World, task: Task, goals: IntArray) -> NDArray[np.float64]:
    """Least cost `[n_cells, goals]` of a flight to each goal, the reward of reaching it left out; inf where there is none.

    Only for a task whose every step costs (`Task.every_step_costs`), where flights end in their goals alone: then no flight
    gains by a move that stays in place. Several times as fast as sweeps over all cells, and exact too.
    """
    n_cells = world.grid.n_cells
    source, target, action = world.airspace.flown()
    low = world.outage_probability(task.threshold_db)[target]
    reward = task.entering_reward(target, low, False) + task.move_reward(source, action, target, MOVED)
    backwards = csr_array((-reward, (target, source)), shape=(n_cells, n_cells))
    return np.asarray(dijkstra(backwards, indices=goals)).T
