"""How old, how still and how near things have to be for a press to be understood."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

NS: Final = 1_000_000_000


@dataclass(frozen=True)
class Freshness:
    """How old and how still a pose has to be. Defaults from CONTRACT, sections 1 and 2, where it gives them."""

    end_effector_s: float = 0.5
    object_s: float = 5.0
    window_s: float = 0.3
    still_m: float = 0.005
    agreeing_rad: float = 0.35
    """Orientations further apart than this within a window are a flip, not noise."""
    gripper_s: float = 0.1
    """By so much the gripper's stamp may run ahead of the press."""
    release_s: float = 2.0
    """So long the gripper may take to move after a press before the press counts as contradicted."""
    far_m: float = 20.0
    """No arm reaches so far: what is there was not given in metres."""
    carried_m: float = 0.02
    """An object that keeps its place relative to the held one within this is carried by it."""

    fingers_s: float = 0.5
    """So long before the gripper's state changes its fingers may have begun to move, the hand standing still."""
    chatter_s: float = 0.25
    """A state of the gripper that lasts less is no closing and no opening."""
    moved_m: float = 0.03
    """Without a button, what the hand moved less far than this was not picked up."""

    @property
    def window_ns(self) -> int:
        """The window [ns] over which poses are averaged, and in which something has to rest."""
        return int(self.window_s * NS)
