"""Who agrees: for each of several users what the tree would mean without them, and which of their actions differ."""

from __future__ import annotations

from typing import Any

from learner.errors import NothingLearnedError
from learner.parameters import Parameters
from learner.understanding import Understanding, understand


def agreement(understood: Understanding, parameters: Parameters) -> list[dict[str, Any]]:
    """One entry a user, by name; empty for a single user.

    `same_without` tells whether leaving the user out gives the same goals (None where the others are too few to make a
    cluster); `differs` names the objects that the user put where the others do not.
    """
    users = sorted({demonstration.user for demonstration in understood.demonstrations})
    return [_of_user(user, understood, parameters) for user in users] if len(users) > 1 else []


def _of_user(user: str, understood: Understanding, parameters: Parameters) -> dict[str, Any]:
    mine = [n for n, demonstration in enumerate(understood.demonstrations) if demonstration.user == user]
    strange = [understood.moves[number] for number in understood.strange]
    differs = sorted({move.object for move in strange if move.demonstration in mine and not move.put_back})
    same = _same_without(user, understood, parameters)
    return {
        "user": user,
        "demonstrations": len(mine),
        "differs": differs,
        "same_without": same,
        "sentence": _sentence(user, differs, same),
    }


def _same_without(user: str, understood: Understanding, parameters: Parameters) -> bool | None:
    others = [demonstration for demonstration in understood.demonstrations if demonstration.user != user]
    if len(others) < parameters.min_samples:
        return None
    try:
        return understand(others, parameters).meaning == understood.meaning
    except NothingLearnedError:
        return False


def _sentence(user: str, differs: list[str], same: bool | None) -> str | None:
    if differs:
        return f"user {user} puts {', '.join(differs)} elsewhere than the others"
    return None if same is not False else f"without user {user} the demonstrations of the others mean another goal"
