"""Demonstrations by hand: what was done where nobody pressed a button (CONTRACT, section 2).

Where the gripper closed on something that then moved with it is a pick; where it opened is a place or a drop, by the
height of the fall. The result are presses as if an operator had pressed them, so that all rules for presses hold.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from learner.model import ActionPress, GripperSample, Recording, Track
from learner.model.condition import DROP_HEIGHT_M, DROP_RADIUS_M
from learner.model.holding import SLIP_M, inside, reaches
from learner.observation.freshness import NS, Freshness
from learner.observation.presses import SIGNAL, Numbered, standing
from learner.observation.resting import rest_ns
from learner.observation.surroundings import Held, Surroundings, last, surroundings_of


@dataclass(frozen=True)
class Closing:
    """The gripper closed at `closed_ns` and opened at `opened_ns` (None: never again); the hand stood before each
    since `stood_ns` and `stood_open_ns`.
    """

    stood_ns: int
    closed_ns: int
    stood_open_ns: int | None
    opened_ns: int | None


def done_in(recording: Recording, freshness: Freshness | None = None) -> tuple[list[Numbered], list[str]]:
    """What was done in a recording, numbered, and a sentence where that had to be told without buttons.

    The presses that stand count; where none of them moves an object, what the gripper did is added to them.
    """
    pressed = standing(recording.presses)
    if any(each.press.type != SIGNAL for each in pressed):
        return pressed, []
    told = list(by_hand(recording, freshness or Freshness()))
    everything = sorted([*(each.press for each in pressed), *told], key=lambda press: press.stamp_ns)
    notes = [f"no button was pressed; the gripper and what moved with it tell {len(told)} actions"] if told else []
    return [Numbered(step, press) for step, press in enumerate(everything)], notes


def by_hand(recording: Recording, freshness: Freshness) -> Iterator[ActionPress]:
    """The picks, places and drops that the gripper and what moved with it tell, in order."""
    if recording.end_effector_frame not in recording.tracks:
        return
    around = surroundings_of(recording, freshness)
    closings = list(_closings(recording.gripper, around))
    for number, closing in enumerate(closings):
        held = _held(closing, around)
        if held is None:
            continue
        yield ActionPress(closing.stood_ns, "pick", held.object)
        if closing.stood_open_ns is not None and closing.opened_ns is not None:
            later = (_held(other, around) for other in closings[number + 1 :])
            again_ns = next((each.stamp_ns for each in later if each and each.object == held.object), None)
            kind = _kind(closing.stood_open_ns, closing.opened_ns, again_ns, held, around)
            yield ActionPress(closing.stood_open_ns, kind, held.object)


def _closings(gripper: Sequence[GripperSample], around: Surroundings) -> Iterator[Closing]:
    """Every time that the gripper closed; what is closed from the beginning was closed on nobody knows what."""
    edges = _edges(gripper, int(around.freshness.chatter_s * NS))
    for (before_ns, _), (at_ns, state), after in zip(edges, edges[1:], [*edges[2:], None], strict=False):
        if state == "closed":
            opened_ns = after[0] if after else None
            stood_open_ns = None if opened_ns is None else _stood_ns(opened_ns, at_ns, around)
            yield Closing(_stood_ns(at_ns, before_ns, around), at_ns, stood_open_ns, opened_ns)


def _edges(gripper: Sequence[GripperSample], chatter_ns: int) -> list[tuple[int, str]]:
    """When the gripper's state became what [ns], its first state included; what lasts less than chatter is none."""
    changes = [(gripper[0].stamp_ns, gripper[0].state)] if gripper else []
    changes += [(b.stamp_ns, b.state) for a, b in pairwise(gripper) if a.state != b.state]
    edges: list[tuple[int, str]] = []
    for number, (stamp_ns, state) in enumerate(changes):
        lasts = number + 1 == len(changes) or changes[number + 1][0] - stamp_ns >= chatter_ns
        if lasts and (not edges or edges[-1][1] != state):
            edges.append((stamp_ns, state))
    return edges


def _stood_ns(moved_ns: int, since_ns: int, around: Surroundings) -> int:
    """Since when the hand had stood [ns] where it was when the gripper moved, at most as long as fingers take."""
    track, freshness = around.tracks[around.end_effector_frame], around.freshness
    earliest_ns = max(since_ns, moved_ns - int(freshness.fingers_s * NS))
    first, at = last(track, earliest_ns) + 1, last(track, moved_ns - 1)
    away = np.linalg.norm(track.positions[first : at + 1] - track.positions[at], axis=1)
    moving = np.flatnonzero(away > freshness.still_m)
    stood = first + (int(moving[-1]) + 1 if len(moving) else 0)
    return int(track.stamps_ns[stood]) if stood <= at else moved_ns - 1


def _held(closing: Closing, around: Surroundings) -> Held | None:
    """What the gripper closed on: the nearest body that then moved with it; None where nothing did."""
    hand, objects = around.hand(closing.stood_ns), around.sightings(closing.stood_ns)
    sizes = {} if around.scene is None else around.scene.sizes
    seen = {name: (pose.position, pose.quaternion_xyzw) for name, pose in objects.items()}
    near = reaches((hand.position, hand.quaternion_xyzw), seen, sizes)
    held = (Held(grasp.object, closing.stood_ns, hand, objects) for grasp in near)
    return next((each for each in held if _moved_with_hand(each, closing, around)), None)


def _moved_with_hand(held: Held, closing: Closing, around: Surroundings) -> bool:
    """Whether an object moved with the hand while it was closed: as it was seen then, else where it was seen later."""
    track, hands = around.tracks[held.object], around.tracks[around.end_effector_frame]
    until_ns = closing.opened_ns or int(hands.stamps_ns[-1])
    begin, end = last(track, closing.closed_ns) + 1, last(track, until_ns) + 1
    at = np.maximum(np.searchsorted(hands.stamps_ns, track.stamps_ns[begin:end], side="right") - 1, 0)
    away = np.linalg.norm(hands.positions[at] - np.array(held.end_effector.position), axis=1)
    gone = np.flatnonzero(away > around.freshness.moved_m)
    if not len(gone):
        return _is_where_it_was_let_go(held, closing, track, around)
    before = inside(_sighting(hands, at=last(hands, held.stamp_ns)), held.objects[held.object].position)
    slips = [
        np.linalg.norm(np.subtract(inside(_sighting(hands, at=int(at[n])), track.positions[begin + n]), before))
        for n in gone.tolist()
    ]
    return bool(np.median(slips) <= SLIP_M)


def _is_where_it_was_let_go(held: Held, closing: Closing, track: Track, around: Surroundings) -> bool:
    """Whether an object that nobody saw while the hand moved was seen next elsewhere, where the hand let it go."""
    after = last(track, closing.opened_ns) + 1 if closing.opened_ns is not None else len(track.stamps_ns)
    if closing.opened_ns is None or after >= len(track.stamps_ns):
        return False
    found, let_go = track.positions[after], around.hand(closing.opened_ns).position
    moved_m = float(np.linalg.norm(found - np.array(held.objects[held.object].position)))
    beside_m = float(np.linalg.norm(found[:2] - np.array(let_go[:2])))
    return moved_m > around.freshness.moved_m and beside_m < DROP_RADIUS_M + SLIP_M


def _kind(stood_ns: int, opened_ns: int, again_ns: int | None, held: Held, around: Surroundings) -> str:
    """Place or drop, by how far the object fell; a place where it was not seen at rest."""
    released = around.sightings(stood_ns, held).get(held.object)
    rested_ns = rest_ns(around.tracks[held.object], opened_ns, again_ns, None, around.freshness)
    if released is None or rested_ns is None:
        return "place"
    rest = around.sightings(rested_ns)[held.object]
    return "drop" if released.position[2] - rest.position[2] > DROP_HEIGHT_M else "place"


def _sighting(track: Track, at: int) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    (a, b, c), (x, y, z, w) = track.positions[at].tolist(), track.quaternions_xyzw[at].tolist()
    return (a, b, c), (x, y, z, w)
