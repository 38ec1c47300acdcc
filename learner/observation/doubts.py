"""What the demonstrations leave in doubt about the tree that is learned from them (CONTRACT, section 3: doubts)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator

from learner.model import Demonstration
from learner.model.doubt import Doubt
from learner.observation.believing import unbelievable
from learner.observation.presses import UNPLANNED


def doubts_of(demonstrations: Iterable[Demonstration]) -> tuple[Doubt, ...]:
    """The doubts of all demonstrations; those of one kind about one object are one, with the first's sentence."""
    found: dict[tuple[str, str | None, str], list[tuple[str, str]]] = defaultdict(list)
    for demonstration in demonstrations:
        for what, name, key, sentence in (*_not_held(demonstration), *_signals(demonstration)):
            found[what, name, key].append((demonstration.demonstration_id, sentence))
    return tuple(
        Doubt(_distinct(identifier for identifier, _ in told), name, what, told[0][1])
        for (what, name, _), told in found.items()
    )


def _not_held(demonstration: Demonstration) -> Iterator[tuple[str, str | None, str, str]]:
    for action in demonstration.actions:
        if action.type == "pick":
            scene = demonstration.scene
            sentence = unbelievable(action.end_effector, action.objects, action.object, scene)
            if sentence:
                yield "held", action.object, "", f"action {action.step} (pick {action.object}): {sentence}"


def _signals(demonstration: Demonstration) -> Iterator[tuple[str, str | None, str, str]]:
    """The demonstration keeps of a signal the sentence alone; without its number it tells which one."""
    for warning in demonstration.warnings:
        if warning.endswith(UNPLANNED):
            yield "signal", None, warning.partition(")")[2], warning


def _distinct(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))
