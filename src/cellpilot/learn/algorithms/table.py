"""The learners by name: own ones, and those that installed packages offer. No JAX here."""

from functools import cache

from cellpilot.errors import InputError
from cellpilot.learn.algorithms.base import LearnerSettings
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER, DDQNHERVariants
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.learn.algorithms.map_learner_settings import MapLearning
from cellpilot.plugins import offered

OWN: dict[str, type[LearnerSettings]] = {
    "ddqn-her": DDQNHER,
    "ddqn-her-variants": DDQNHERVariants,
    "fqi-her": FQIHER,
    "map-learner": MapLearning,
}
GROUP = "cellpilot.learners"
"""Entry points of other packages: name of the algorithm -> its subclass of `LearnerSettings`."""


@cache
def learners() -> dict[str, type[LearnerSettings]]:
    """Settings by the name of the algorithm.

    `InputError` names an entry point that cannot be imported, is no `LearnerSettings`, or takes a name that is taken.
    """
    found = dict(OWN)
    for name, (settings, origin) in offered(GROUP).items():
        if not (isinstance(settings, type) and issubclass(settings, LearnerSettings)):
            raise InputError(f"the learner {name} ({origin}) is no subclass of cellpilot.learn.LearnerSettings")
        if name in found or settings.model_fields["algorithm"].default != name:
            raise InputError(f"the learner {name} ({origin}): its field algorithm has to be that name, and no other's")
        found[name] = settings
    return found
