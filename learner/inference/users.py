"""Who agrees: what the demonstrations mean without each of several users, and which of their actions differ."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from learner.errors import NothingLearnedError
from learner.inference.understanding import Understanding, understand_samples
from learner.model.poses import Mask


def understood_without(understood: Understanding) -> dict[str, Understanding | None]:
    """For each of several users, by name, what the demonstrations of the others mean.

    None where they are too few to make a cluster, or mean nothing; empty for a single user.
    """
    samples = understood.samples
    users, least = np.unique(samples.users).tolist(), understood.parameters.min_samples
    if len(users) == 1:
        return {}
    return {
        user: understood_of(others, understood) if (others := samples.users != user).sum() >= least else None
        for user in users
    }


def understood_of(which: Mask, understood: Understanding) -> Understanding | None:
    """What some of the demonstrations (k,) mean by themselves; None if that is nothing."""
    try:
        return understand_samples(understood.samples.of_demonstrations(which), understood.parameters)
    except NothingLearnedError:
        return None


def agreement(understood: Understanding, without: Mapping[str, Understanding | None]) -> list[dict[str, Any]]:
    """One entry a user, by name; empty for a single user.

    `same_without` tells whether leaving the user out gives the same goals (None where the others' mean nothing);
    `differs` names the objects that the user put where the others do not.
    """
    return [_of_user(user, understood, others) for user, others in without.items()]


def _of_user(user: str, understood: Understanding, others: Understanding | None) -> dict[str, Any]:
    moves, strange = understood.moves, np.array(understood.strange, dtype=np.intp)
    mine = strange[understood.samples.users[moves.demonstration[strange]] == user]
    differs = np.unique(moves.object[mine[~moves.put_back[mine]]]).tolist()
    same = None if others is None else others.meaning == understood.meaning
    return {
        "user": user,
        "demonstrations": int((understood.samples.users == user).sum()),
        "differs": differs,
        "same_without": same,
        "sentence": _sentence(user, differs, same),
    }


def _sentence(user: str, differs: list[str], same: bool | None) -> str | None:
    if differs:
        return f"user {user} puts {', '.join(differs)} elsewhere than the others"
    return None if same is not False else f"without user {user} the demonstrations of the others mean another goal"
