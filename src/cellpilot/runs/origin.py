"""What a result was made from, as digests that travel with it."""

from typing import TYPE_CHECKING

import numpy as np

from cellpilot.policies import PolicyParameters
from cellpilot.provenance import digest
from cellpilot.task import Task

if TYPE_CHECKING:
    from cellpilot.maps import RadioMap


def map_digest(radio_map: "RadioMap") -> str:
    """Digest of all variables and coordinates of a map, by name."""
    return digest(
        part
        for name in sorted(map(str, radio_map.variables))
        for part in (np.frombuffer(name.encode(), np.uint8), _plain(radio_map[name].values))
    )


def policy_digest(parameters: PolicyParameters | None) -> str:
    """Digest of the weights by name, with architecture and sides; "none" without a policy."""
    if parameters is None:
        return "none"
    about = f"{parameters.architecture} {parameters.sides} {parameters.about.get('look_ahead')}"
    tensors = [
        part for name in sorted(parameters.tensors) for part in (np.frombuffer(name.encode(), np.uint8), parameters.tensors[name])
    ]
    return digest([np.frombuffer(about.encode(), np.uint8), *tensors])


def origin_warning(parameters: PolicyParameters, radio_map: "RadioMap", task: Task, seed: int) -> str | None:
    """What says that a policy in a run folder was trained elsewhere: another map, task or seed; None where nothing does."""
    about = parameters.about
    trained_on = {"map": map_digest(radio_map), "task": task.as_dict(), "seed": seed}
    stated = about | ({"task": Task(**about["task"]).as_dict()} if isinstance(about.get("task"), dict) else {})
    other = [name for name, here in trained_on.items() if name in stated and stated[name] != here]
    if not other:
        return None
    return f"the policy was trained with another {' and another '.join(other)} than this run has"


def _plain(values: np.ndarray) -> np.ndarray:
    """Text as its bytes: the same text comes as several types."""
    if values.dtype.kind in "biuf":
        return values
    return np.frombuffer("\0".join(map(str, values.ravel().tolist())).encode("utf-8", "surrogatepass"), np.uint8)
