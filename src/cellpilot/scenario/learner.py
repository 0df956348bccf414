"""Which learners a scenario can name, and the one that it has without being told."""

from typing import TYPE_CHECKING, Union

from cellpilot.learn.algorithms.base import LearnerSettings
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER
from cellpilot.learn.algorithms.table import learners

LEARNERS = learners()
"""Settings by the name of the algorithm."""

if TYPE_CHECKING:
    AnyLearner = LearnerSettings
else:
    AnyLearner = Union[tuple(LEARNERS.values())]  # noqa: UP007  # the members are known at run time only

PUBLISHED_LEARNER = DDQNHER()
"""The learner of the thesis."""
