"""Exact values of every state and action of a world, for the goals asked for."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellpilot.array_types import FloatArray
from cellpilot.errors import InputError
from cellpilot.grid import IntArray
from cellpilot.solve.cheapest_paths import least_cost
from cellpilot.task import Task
from cellpilot.world import World

CONVERGED = 1e-9
COST_OF_NOTHING = 1e-6
MAX_SWEEPS = 20_000
NOTHING_LEFT = 1e-18
"""A discount so small that what lies behind it does not count."""
LARGE_CELLS = 20_000
"""Above so many cells sweeps number thousands, and policy iteration is some thirty times as fast."""
GOALS_SOLVED_AT_ONCE = 64
MOST_VALUES_SOLVED = 4_000_000
"""Cells times goals of one table (32 MB, of which some ten are kept at a time)."""


def optimal_values(world: World, task: Task, goals: IntArray, discount: float | None = None) -> FloatArray:
    """Q*(cell, goal, action) `[n_cells, goals, actions]` at the task's (or the given) discount; -inf for an action not offered.

    Starts from a lower bound, so the value of every state whose best flight reaches the goal in n steps is exact after
    n sweeps. Without discount, where every step costs, the values are those of cheapest paths instead. Values of cells
    that cannot reach the goal are those of flying for ever (-inf without discount).
    `InputError` where the undiscounted optimum does not exist because circling earns rewards.
    """
    goals = np.asarray(goals)
    at_once = goals_solved_at_once(world)
    gamma = task.discount if discount is None else discount
    if gamma == 1 and task.rho_step == 0:
        # Where moving costs nothing every way round is equally good: among those, the one with the fewest steps.
        task = replace(task, rho_step=-COST_OF_NOTHING)
    blocks = [_Problem(world, task, goals[i : i + at_once], gamma) for i in range(0, len(goals), at_once)]
    return np.concatenate([_solve(block) for block in blocks], axis=1)


def goals_solved_at_once(world: World) -> int:
    """Goals for which all cells are solved at once: as many as memory allows."""
    return max(1, min(GOALS_SOLVED_AT_ONCE, MOST_VALUES_SOLVED // world.grid.n_cells))


@dataclass(frozen=True)
class _Problem:
    """A world, a task, some goals, and the discount."""

    world: World
    task: Task
    goals: IntArray
    discount: float

    def outcomes(self, action: int) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Expected reward `[n_cells, goals]` of the action, -inf where it is not offered, and whether it ends the flight."""
        cell = np.arange(self.world.grid.n_cells)[:, None]
        reward, _, terminated = self.task.expected_outcome(self.world, cell, action, self.goals[None, :])
        if self.world.airspace.rule == "mask":
            reward = np.where(self.world.airspace.offered[:, action, None], reward, -np.inf)
        return reward, terminated

    @property
    def paths_will_do(self) -> bool:
        """Whether the best flights without discount are cheapest paths to the goal."""
        return self.task.every_step_costs and not self.world.airspace.ends


def _solve(problem: _Problem) -> FloatArray:
    if problem.paths_will_do and problem.discount == 1:
        return _by_paths(problem)
    if problem.paths_will_do and problem.world.grid.n_cells > LARGE_CELLS:
        # One goal at a time: what it looks up stays in the cache of a core.
        single = [replace(problem, goals=problem.goals[i : i + 1]) for i in range(len(problem.goals))]
        return np.concatenate([_by_policy_iteration(one) for one in single], axis=1)
    return _by_sweeps(problem)


def _by_paths(problem: _Problem) -> FloatArray:
    goals, airspace = problem.goals, problem.world.airspace
    value = problem.task.rho_goal - least_cost(problem.world, problem.task, goals)
    value[goals, np.arange(len(goals))] = -np.inf
    values = []
    for action in range(airspace.n_actions):
        reward, terminated = problem.outcomes(action)
        values.append(reward + np.where(terminated, 0.0, value[airspace.next_cell[:, action]]))
    return np.stack(values, axis=-1)


def _by_sweeps(problem: _Problem) -> FloatArray:
    """Value iteration (Bellman 1957) from a lower bound."""
    world, task, goals, discount = problem.world, problem.task, problem.goals, problem.discount
    next_cell, n_actions = world.airspace.next_cell, world.airspace.n_actions
    reward, terminated = zip(*(problem.outcomes(a) for a in range(n_actions)), strict=True)
    floor = -np.inf if discount == 1 else replace(task, discount=discount).value_bounds(world.airspace.ends)[0]
    value = np.full((world.grid.n_cells, len(goals)), floor)
    at_goal = (goals, np.arange(len(goals)))
    reachable = world.airspace.part[:, None] == world.airspace.part[goals][None, :]

    def back_up(action: int) -> FloatArray:
        future = discount * value[next_cell[:, action]]
        return np.asarray(reward[action] + np.where(terminated[action], 0.0, future))

    for _ in range(MAX_SWEEPS):
        new = back_up(0)
        for action in range(1, n_actions):
            np.maximum(new, back_up(action), out=new)
        new[at_goal] = floor
        change = np.abs(np.subtract(new, value, out=np.zeros_like(new), where=reachable & np.isfinite(new))).max()
        value = new
        if change < CONVERGED:
            return np.stack([back_up(a) for a in range(n_actions)], axis=-1)
    if discount == 1:
        raise InputError(
            "the optimum does not exist without discount: circling earns rewards; make rho_step negative or the discount below 1"
        )
    raise InputError(f"the optimum was not found in {MAX_SWEEPS} sweeps at discount {discount:g}: lower the discount")


def _by_policy_iteration(problem: _Problem) -> FloatArray:
    """Discounted values where every step costs (Howard 1960); begins with the cheapest paths, which are nearly the best ones.

    A state is a pair (goal, cell), all of them in one row. In the goal and in blocked cells everything ends, at no cost.
    """
    world, task, goals, discount = problem.world, problem.task, problem.goals, problem.discount
    n_cells, n_actions = world.grid.n_cells, world.airspace.n_actions
    n_states = len(goals) * n_cells
    over = ((np.arange(n_cells)[None, :] == goals[:, None]) | world.airspace.blocked).ravel()
    next_state = np.empty((n_actions, n_states), np.intp)
    reward = np.empty((n_actions, n_states))
    for action in range(n_actions):
        leads = world.airspace.next_cell[:, action] + n_cells * np.arange(len(goals))[:, None]
        next_state[action] = np.where(over, np.arange(n_states), leads.ravel())
        reward[action] = np.where(over, 0.0, problem.outcomes(action)[0].T.ravel())
    first = np.where(over, 0.0, -least_cost(world, task, goals).T.ravel())
    policy = np.argmax(reward + first[next_state], axis=0)
    rounding = 4e-15 * sum(abs(price.reward) for price in task.possible_prices(world.airspace.ends)) / (1 - discount)
    for _ in range(MAX_SWEEPS):
        value = _value_of(next_state, reward, policy, over, discount)
        values = reward + discount * value[next_state]
        better = values.max(0) > value + rounding
        if not better.any():
            return values.T.reshape(len(goals), n_cells, n_actions).swapaxes(0, 1)
        policy[better] = values[:, better].argmax(0)
    raise InputError(f"the optimum was not found in {MAX_SWEEPS} policies at discount {discount:g}: lower the discount")


def _value_of(
    next_state: NDArray[np.intp], reward: NDArray[np.float64], policy: IntArray, over: NDArray[np.bool_], discount: float
) -> NDArray[np.float64]:
    """Discounted return `[states]` of a policy: what 2, 4, 8, ... steps earn, until all is over or discounted to nothing."""
    state = np.arange(len(policy))
    end, value = next_state[policy, state], reward[policy, state]
    while discount > NOTHING_LEFT and not over[end].all():
        value, end, discount = value + discount * value[end], end[end], discount * discount
    return value
