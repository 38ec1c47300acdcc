"""The lights that are always in view: what is seen, the gripper, the disk, losses; green, yellow or red, with words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

from pipelines.panel.sentences import Voice
from pipelines.panel.watch import Frames, Sight

Color = Literal["green", "yellow", "red", "grey"]

FRESH_S: Final = 1.0
"""A marker seen within this time [s] is seen now."""
HIDDEN_S: Final = 5.0
"""After so long [s] a hidden object's pose counts no more (CONTRACT, section 1)."""
HAND_S: Final = 0.5
"""After so long [s] the hand's pose counts no more (CONTRACT, section 1)."""
GRIPPER_S: Final = 2.0
"""The gripper tells its state once a second at least."""
LITTLE_BYTES: Final = 5 << 30
NONE_BYTES: Final = 500 << 20


@dataclass(frozen=True)
class Light:
    """One light: a name, what it says, and its color."""

    name: str
    text: str
    color: Color


def lights_of(sight: Sight, frames: Frames, voice: Voice) -> tuple[Light, ...]:
    """The lights of a moment, the most general first."""
    odd = (Light(voice("cell_itself"), sight.oddity, "yellow"),) if sight.oddity else ()
    told = (_recorder(sight, voice), _gripper(sight, voice), *_disk(sight, voice), *_markers(sight, frames, voice))
    return (*told, *odd)


def _recorder(sight: Sight, voice: Voice) -> Light:
    if sight.status is None:
        return Light(voice("recorder"), voice("silent"), "red")
    return Light(voice("recorder"), voice(f"state_{sight.status['state']}"), "green")


def _gripper(sight: Sight, voice: Voice) -> Light:
    age_s = sight.gripper_age_s
    if sight.gripper is None or age_s is None:
        return Light(voice("gripper"), voice("unknown"), "red")
    text = voice(f"gripper_{sight.gripper}")
    return Light(voice("gripper"), text, "green" if age_s < GRIPPER_S else "red")


def _disk(sight: Sight, voice: Voice) -> Iterator[Light]:
    if sight.status is None:
        return
    free = int(sight.status["disk_free_bytes"])
    color: Color = "green" if free > LITTLE_BYTES else "yellow" if free > NONE_BYTES else "red"
    yield Light(voice("disk"), voice("free", gigabytes=f"{free / (1 << 30):.1f}"), color)
    yield Light(voice("losses"), *_losses(sight.status, voice))


def _losses(status: Mapping[str, Any], voice: Voice) -> tuple[str, Color]:
    counts = status["lost"]
    lost = sum(count for count in counts.values() if count)
    if lost:
        return voice("lost", count=lost), "red"
    unknown = any(count is None for count in counts.values())
    return (voice("lost_unknown"), "yellow") if unknown else (voice("lost_none"), "green")


def _markers(sight: Sight, frames: Frames, voice: Voice) -> Iterator[Light]:
    if frames.hand not in sight.ages_s:
        yield Light(frames.hand, voice("not_seen"), "red")
    for name in sorted(sight.ages_s, key=lambda name: (name != frames.hand, name)):
        age_s, limit_s = sight.ages_s[name], HAND_S if name == frames.hand else HIDDEN_S
        color: Color = "green" if age_s < min(FRESH_S, limit_s) else "yellow" if age_s < limit_s else "red"
        text = voice("seen") if color == "green" else voice("seen_before", seconds=f"{age_s:.0f}")
        yield Light(name, text, color)
