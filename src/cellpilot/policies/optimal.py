"""The exact optimum: value iteration on the true world, for the goals asked for."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from cellpilot.errors import InputError
from cellpilot.grid import IntArray
from cellpilot.policies.base import greedy_actions, one_hot
from cellpilot.task import Task
from cellpilot.world import World

CONVERGED = 1e-9
COST_OF_NOTHING = 1e-6
MAX_SWEEPS = 20_000
NOTHING_LEFT = 1e-18
"""A discount so small that what lies behind it does not count."""
LARGE_CELLS = 20_000
"""Above so many cells sweeps number thousands, and policy iteration is some thirty times as fast."""
GOALS_AT_ONCE = 64
MOST_VALUES = 4_000_000
"""Cells times goals of one table (32 MB, of which some ten are kept at a time)."""


def optimal_values(world: World, task: Task, goals: IntArray, discount: float | None = None) -> NDArray[np.float64]:
    """Q*(cell, goal, action) `[n_cells, goals, actions]` by value iteration at the task's (or the given) discount.

    Starts from a lower bound, so the value of every state whose best flight reaches the goal in n steps is exact after
    n sweeps. Without discount, where every step costs, the values are those of cheapest paths instead. Values of cells
    that cannot reach the goal are those of flying for ever (-inf without discount).
    `InputError` where the undiscounted optimum does not exist because circling earns rewards.
    """
    goals = np.asarray(goals)
    at_once = goals_at_once(world)
    blocks = [goals[i : i + at_once] for i in range(0, len(goals), at_once)]
    gamma = task.discount if discount is None else discount
    if gamma == 1 and task.rho_step == 0:
        # Where moving costs nothing every way round is equally good: among those, the one with the fewest steps.
        task = replace(task, rho_step=-COST_OF_NOTHING)
    return np.concatenate([_solve(world, task, block, gamma) for block in blocks], axis=1)


def goals_at_once(world: World) -> int:
    """Goals for which all cells are solved at once: as many as memory allows."""
    return max(1, min(GOALS_AT_ONCE, MOST_VALUES // world.grid.n_cells))


def _solve(world: World, task: Task, goals: IntArray, discount: float) -> NDArray[np.float64]:
    n_cells, n_actions = world.grid.n_cells, world.grid.n_actions
    cell = np.arange(n_cells)[:, None]
    low = np.nan_to_num(world.low_probability(task.threshold_db))
    reward, entered = zip(*(task.expected_outcome(world, cell, a, goals[None, :], low) for a in range(n_actions)), strict=True)
    worst = min(0.0, task.rho_step) + min(0.0, task.rho_sinr) + min(0.0, task.rho_blocked)
    floor = -np.inf if discount == 1 else worst / (1 - discount)
    value = np.full((n_cells, len(goals)), floor)
    at_goal = (goals, np.arange(len(goals)))
    reachable = world.part[:, None] == world.part[goals][None, :]

    def back_up(action: int) -> NDArray[np.float64]:
        future = discount * value[world.next_cell[:, action]]
        return np.asarray(reward[action] + np.where(entered[action], 0.0, future))

    if discount == 1 and task.rho_step + max(0.0, task.rho_sinr) < 0 and task.rho_blocked <= 0:
        value = task.rho_goal - _least_cost(world, task, goals, low)
        value[at_goal] = floor
        return np.stack([back_up(a) for a in range(n_actions)], axis=-1)
    if n_cells > LARGE_CELLS and task.rho_step + max(0.0, task.rho_sinr) < 0 and task.rho_blocked <= 0:
        # One goal at a time: what it looks up stays in the cache of a core.
        return np.concatenate(
            [_by_policy_iteration(world, task, goals[i : i + 1], discount, low) for i in range(len(goals))], axis=1
        )
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


def _by_policy_iteration(
    world: World, task: Task, goals: IntArray, discount: float, low: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Discounted values where every step costs (Howard 1960); begins with the cheapest paths, which are nearly the best ones.

    A state is a pair (goal, cell), all of them in one row. In the goal and in blocked cells everything ends, at no cost.
    """
    n_cells, n_actions = world.grid.n_cells, world.grid.n_actions
    n_states = len(goals) * n_cells
    cell, goal = np.arange(n_cells)[None, :], goals[:, None]
    over = ((cell == goal) | world.blocked).ravel()
    next_state = np.empty((n_actions, n_states), np.intp)
    reward = np.empty((n_actions, n_states))
    for action in range(n_actions):
        leads = world.next_cell[:, action] + n_cells * np.arange(len(goals))[:, None]
        next_state[action] = np.where(over, np.arange(n_states), leads.ravel())
        reward[action] = np.where(over, 0.0, task.expected_outcome(world, cell, action, goal, low)[0].ravel())
    first = np.where(over, 0.0, -_least_cost(world, task, goals, low).T.ravel())
    policy = np.argmax(reward + first[next_state], axis=0)
    rounding = 4e-15 * (abs(task.rho_goal) + abs(task.rho_step) + abs(task.rho_sinr) + abs(task.rho_blocked)) / (1 - discount)
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


def _least_cost(world: World, task: Task, goals: IntArray, low: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least cost `[n_cells, goals]` of a flight to each goal where every step costs: Dijkstra backwards from the goals.

    It is several times as fast as sweeps over all cells, and exact too.
    """
    n_cells, n_actions = world.next_cell.shape
    source, target = np.repeat(np.arange(n_cells), n_actions), world.next_cell.ravel()
    moves = (source != target) & ~world.blocked[source]
    cost = -(task.rho_step + task.rho_sinr * low[target[moves]])
    backwards = csr_array((cost, (target[moves], source[moves])), shape=(n_cells, n_cells))
    return np.asarray(dijkstra(backwards, indices=goals)).T


@dataclass(frozen=True)
class OptimalPolicy:
    """Maximises the expected return at the task's discount (or at `discount`); ties to the lowest action index."""

    world: World
    task: Task
    discount: float | None = None
    name: str = "optimal"
    deterministic: bool = True
    _actions: dict[int, NDArray[np.int8]] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def undiscounted(cls, world: World, task: Task) -> "OptimalPolicy":
        """The optimum for discount 1, the measure by which every policy is scored."""
        return cls(world, task, 1.0, "optimal-undiscounted")

    def actions(self, goals: IntArray) -> NDArray[np.int8]:
        """Best action of every cell for each goal, `[n_cells, goals]`; solved once per goal."""
        missing = np.array([g for g in np.unique(goals) if int(g) not in self._actions], dtype=np.int32)
        at_once = goals_at_once(self.world)
        for i in range(0, len(missing), at_once):
            block = missing[i : i + at_once]
            best = greedy_actions(np.nan_to_num(optimal_values(self.world, self.task, block, self.discount), neginf=-1e18))
            self._actions.update({int(goal): best[:, k].copy() for k, goal in enumerate(block)})
        return np.stack([self._actions[int(g)] for g in goals], axis=1)

    def action_probabilities(self, goals: IntArray) -> NDArray[np.float32]:
        """One-hot rows `[n_cells, goals, actions]`."""
        return one_hot(self.actions(goals), self.world.grid.n_actions)
