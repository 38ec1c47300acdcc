"""People as data: how they demonstrate. FOURTEEN are the non-experts of the paper's experiment (tower and box)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from learner.model.pose import Vector
from learner.simulation.script import MoveType, ScriptedMove

from .scenarios import OVER_BOX, SCENARIOS

DEGREE: Final = math.radians(1.0)


@dataclass(frozen=True)
class User:
    """How somebody demonstrates, and how well the cell sees it. Lengths [m], angles [rad], standard deviations.

    What they do: `verbs` are the objects that they release with another verb; `orders` the orders of the script's
    steps, one for each demonstration in turn; `moves_first` an object that they move elsewhere before they begin;
    `coincidence` (object, of, offset) a start that happens to be the same in every demonstration; `scripts` what they
    do instead of the task. `mistakes` is how often a step begins with a wrong object that is put back; `quarter_turns`:
    cubes are grasped and placed at any quarter turn; `unnamed`: presses name no object; `grasp_height_m`: where on a
    cube they grasp. What the cell sees: camera, rate, markers glued crooked, flips (share of the samples), objects
    hidden near the hand, pauses.
    """

    name: str
    hand_m: float = 0.003
    hand_rad: float = DEGREE
    grasp_height_m: float = 0.0
    verbs: tuple[tuple[str, MoveType], ...] = ()
    orders: tuple[tuple[int, ...], ...] = ()
    moves_first: str | None = None
    coincidence: tuple[str, str, Vector] | None = None
    scripts: tuple[tuple[ScriptedMove, ...], ...] = ()
    mistakes: float = 0.0
    quarter_turns: bool = False
    unnamed: bool = False
    camera_m: float = 0.0015
    camera_rad: float = 0.3 * DEGREE
    rate_hz: float = 30.0
    crooked_rad: float = 0.0
    flips: float = 0.0
    hidden_m: float = 0.0
    pauses_s: float = 0.0


EXPERT: Final = User("expert")
REAL: Final = User(
    "real",
    mistakes=0.1,
    quarter_turns=True,
    unnamed=True,
    camera_rad=DEGREE,
    rate_hz=20.0,
    crooked_rad=3 * DEGREE,
    flips=0.01,
    hidden_m=0.12,
    pauses_s=1.0,
)
"""An expert in a cell as it is: every kind of noise at once."""

STACK_BY_DROP: Final[tuple[tuple[str, MoveType], ...]] = (("D", "drop"), ("F", "drop"))
_BOX: Final = ScriptedMove("drop", "A", "box", OVER_BOX)
_UPSIDE_DOWN: Final = (
    ScriptedMove("place", "D", "F", (0.0, 0.0, 0.05)),
    ScriptedMove("place", "E", "D", (0.0, 0.0, 0.05)),
    _BOX,
)
_ANYHOW: Final = (
    (ScriptedMove("drop", "D", "box", OVER_BOX), ScriptedMove("place", "A", "E", (0.0, 0.0, 0.05))),
    (ScriptedMove("place", "E", "A", (0.0, 0.0, 0.05)), ScriptedMove("drop", "F", "box", OVER_BOX)),
    (ScriptedMove("place", "D", "F", (0.0, 0.1, 0.0)), ScriptedMove("place", "D", "A", (0.0, 0.0, 0.05))),
)
FOURTEEN: Final = (
    User("user01"),
    User("user02", hand_m=0.002, orders=((2, 0, 1),)),
    User("user03", grasp_height_m=0.008, quarter_turns=True),
    User("user04", unnamed=True, pauses_s=1.0, rate_hz=15.0),
    User("user05", grasp_height_m=-0.008, rate_hz=60.0, hidden_m=0.12),
    User("user06", orders=((0, 2, 1), (2, 0, 1), (0, 1, 2))),
    User("user07", moves_first="E"),
    User("user08", verbs=STACK_BY_DROP),
    User("user09", verbs=STACK_BY_DROP[1:]),
    User("user10", verbs=(("A", "place"),)),
    User("user11", verbs=STACK_BY_DROP, orders=((0, 2, 1),)),
    User("user12", coincidence=("A", "E", (0.15, 0.1, 0.0))),
    User("user13", scripts=(_UPSIDE_DOWN,)),
    User("user14", scripts=_ANYHOW),
)
"""The paper's fourteen, all for SCENARIOS['tower_and_box']: 1 to 5 consistent; 6 interleaves; 7 moves the base of the
tower first; 8, 9, 11 drop to stack; 10 places into the box; 12 has A stand the same way beside the tower each time;
13 and 14 misunderstand."""
FOURTEEN_SCENARIO: Final = SCENARIOS["tower_and_box"]
