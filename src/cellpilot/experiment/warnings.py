"""Sentences about a threshold or a policy that is hardly what its user wanted; none stops anything."""

import numpy as np

from cellpilot.policies import PolicyParameters
from cellpilot.policies.pair_value import ARCHITECTURE
from cellpilot.task import Task
from cellpilot.world import World

MOST_PAIRS_LOOKED_AT = 1_000_000
"""Pairs of cell and goal whose values are looked at together."""


def threshold_warning(world: World, threshold_db: float) -> str | None:
    """A sentence if more than 95 % or fewer than 1 % of the free cells lie below the threshold."""
    share = float((world.signal.mean_db[world.airspace.free_cells] < threshold_db).mean())
    if share > 0.95:
        return f"{share:.1%} of the cells lie below {threshold_db:g} dB: hardly any route avoids them; consider a lower threshold"
    if share < 0.01:
        few = f"only {share:.1%} of the cells lie below {threshold_db:g} dB"
        return f"{few}: there is hardly anything to avoid; consider a higher threshold"
    return None


def divergence_warning(parameters: PolicyParameters, world: World, task: Task) -> str | None:
    """A sentence if the learned values, looked at for some goals, lie outside what any flight can earn."""
    goals = world.airspace.free_cells[:: max(1, len(world.airspace.free_cells) // 50)]
    at_once = max(1, MOST_PAIRS_LOOKED_AT // world.grid.n_cells)
    least, greatest = task.value_bounds(world.airspace.ends)
    lowest, highest = np.inf, -np.inf
    for i in range(0, len(goals), at_once):
        values = parameters.values(world.grid, goals[i : i + at_once])
        lowest, highest = min(lowest, float(values.min())), max(highest, float(values.max()))
    usual = sum(abs(price.reward) for price in task.possible_prices(world.airspace.ends))
    if highest <= greatest + usual and lowest >= 2 * least - usual:  # some over-estimation is usual
        return None
    mend = "lower `learner.learning_rate`" if parameters.architecture == ARCHITECTURE else "leave `learner.clip_targets` on"
    return (
        f"training has diverged: values from {lowest:.3g} to {highest:.3g}, where a flight earns {least:g} to {greatest:g};"
        f" use another seed, or {mend}"
    )
