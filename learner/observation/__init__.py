"""From a recording to a demonstration: which world surrounded each press, and where the object came to rest.

`observing` reads: the presses that stand (`presses`), else what the gripper tells without any (`segmenting`), are
judged by the rules that the recorder applies too, with what was seen around them (`surroundings`), by what a cell could
believe of them (`believing`); `resting` finds where what was released came to rest, `doubts` gathers for a tree what
its demonstrations leave in doubt. Calls go that way alone.
"""

from learner.observation.freshness import Freshness
from learner.observation.observing import observe, warnings_of

__all__ = ["Freshness", "observe", "warnings_of"]
