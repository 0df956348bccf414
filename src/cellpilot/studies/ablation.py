"""The ablation of section 5.4: double learning and hindsight on and off."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cellpilot.errors import InputError
from cellpilot.experiment import fingerprint
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER, DDQNHERVariants
from cellpilot.runs import Run
from cellpilot.scenario import Scenario
from cellpilot.storage import load_array, save_array, save_netcdf

if TYPE_CHECKING:
    import xarray as xr
from cellpilot.studies.progress import within

VARIANTS = {"DQN": (False, False), "DDQN": (True, False), "DQN+HER": (False, True), "DDQN+HER": (True, True)}
"""Figure 5.19: name -> (double, hindsight)."""
SWITCHED_LEARNER = "ddqn-her"
"""The thesis's algorithm, which alone has these two switches."""
EARLY_EPISODES = 3_000
"""The first part of training, over which the area under the learning curve is compared."""


def check_ablation(scenario: Scenario) -> None:
    """`InputError` if the scenario's learner has no double learning and hindsight to switch off."""
    if not isinstance(scenario.learner, DDQNHER):
        raise InputError(
            f"the ablation switches double learning and hindsight of {SWITCHED_LEARNER}, but {scenario.name} trains "
            f"{scenario.learner.algorithm}: add `learner.algorithm` {SWITCHED_LEARNER}"
        )


def ablation(run: Run, n_seeds: int, progress: Callable[[float], None] = lambda share: None) -> "xr.Dataset | None":
    """Learning curves `episode_return (variant, seed, episode)` of the four variants, seeds 0..n-1, into `ablation.nc`.

    All seeds of a variant are trained at once. Finished ones are kept in the folder `ablation/`, unfinished ones as
    checkpoints, so an interrupted study goes on where it stopped; None if it was interrupted.
    """
    import xarray as xr

    curves: list[np.ndarray] = []
    for i, name in enumerate(VARIANTS):
        of_variant = _variant_curves(run, name, n_seeds, partial(within, progress, i, len(VARIANTS)))
        if of_variant is None:
            return None
        curves.append(of_variant)
    values = np.stack(curves).astype(np.float32)
    dataset = xr.Dataset(
        {
            "episode_return": (
                ("variant", "seed", "episode"),
                values,
                {"units": "1", "long_name": "return of the exploring policy"},
            )
        },
        coords={"variant": list(VARIANTS), "seed": np.arange(n_seeds)},
        attrs={"scenario": run.scenario.name},
    )
    save_netcdf(dataset, run.folder / "ablation.nc")
    return dataset


def _variant_curves(run: Run, name: str, n_seeds: int, progress: Callable[[float], None]) -> np.ndarray | None:
    """Learning curves `[seeds, episodes]` of one variant, read or trained; None if training was interrupted."""
    from cellpilot.learn.compile import forget_programs
    from cellpilot.learn.trainer import train_many

    double, hindsight = VARIANTS[name]
    published = run.scenario.learner.model_dump(exclude={"algorithm"})
    learner = DDQNHERVariants(**published | {"double": double, "hindsight": hindsight})
    mark = fingerprint(run.scenario.changed(learner=learner), run.world)
    folder = run.folder / "ablation"
    file = lambda seed: folder / f"{name}-{seed}-{mark}.npy"
    checkpoint = lambda seed: folder / f"{name}-{seed}.safetensors"
    if missing := [seed for seed in range(n_seeds) if not file(seed).is_file()]:
        results = train_many(
            learner,
            run.place,
            missing,
            checkpoints=[checkpoint(seed) for seed in missing],
            fingerprint=mark,
            progress=lambda p: progress(p.done / p.rounds),
        )
        if not all(result.finished for result in results):
            return None
        for result in results:
            curve = result.history["episode_return"]
            save_array(curve, file(result.seed))
            checkpoint(result.seed).unlink()
        forget_programs()
    progress(1.0)
    return np.stack([load_array(file(seed)) for seed in range(n_seeds)])


def early_return(dataset: "xr.Dataset") -> dict[str, tuple[float, float]]:
    """Mean return per episode over the first 3,000 episodes by variant: mean and standard deviation over seeds.

    This is the area under the learning curve divided by its width.
    """
    early = dataset["episode_return"].isel(episode=slice(EARLY_EPISODES)).mean("episode")
    spread = early.std("seed", ddof=1)  # NaN for one seed
    return {
        str(name): (float(early.sel(variant=name).mean()), float(spread.sel(variant=name))) for name in early["variant"].values
    }
