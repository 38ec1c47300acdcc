"""Who agrees: what the demonstrations mean without each of several users, and which of their actions differ."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from learner.errors import NothingLearnedError
from learner.inference.understanding import Understanding, understand


def understood_without(understood: Understanding) -> dict[str, Understanding | None]:
    """For each of several users, by name, what the demonstrations of the others mean.

    None where they are too few to make a cluster, or mean nothing; empty for a single user.
    """
    users = sorted({demonstration.user for demonstration in understood.demonstrations})
    return {user: _of_others(user, understood) for user in users} if len(users) > 1 else {}


def _of_others(user: str, understood: Understanding) -> Understanding | None:
    others = [demonstration for demonstration in understood.demonstrations if demonstration.user != user]
    try:
        return understand(others, understood.parameters) if len(others) >= understood.parameters.min_samples else None
    except NothingLearnedError:
        return None


def agreement(understood: Understanding, without: Mapping[str, Understanding | None]) -> list[dict[str, Any]]:
    """One entry a user, by name; empty for a single user.

    `same_without` tells whether leaving the user out gives the same goals (None where the others' mean nothing);
    `differs` names the objects that the user put where the others do not.
    """
    return [_of_user(user, understood, others) for user, others in without.items()]


def _of_user(user: str, understood: Understanding, others: Understanding | None) -> dict[str, Any]:
    mine = [n for n, demonstration in enumerate(understood.demonstrations) if demonstration.user == user]
    strange = [understood.moves[number] for number in understood.strange]
    differs = sorted({move.object for move in strange if move.demonstration in mine and not move.put_back})
    same = None if others is None else others.meaning == understood.meaning
    return {
        "user": user,
        "demonstrations": len(mine),
        "differs": differs,
        "same_without": same,
        "sentence": _sentence(user, differs, same),
    }


def _sentence(user: str, differs: list[str], same: bool | None) -> str | None:
    if differs:
        return f"user {user} puts {', '.join(differs)} elsewhere than the others"
    return None if same is not False else f"without user {user} the demonstrations of the others mean another goal"
