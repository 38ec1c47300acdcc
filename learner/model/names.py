"""Names that come from outside: what the contract admits, refused where they enter."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

from learner.errors import NameRefusedError

NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}", re.ASCII)
RULE: Final = (
    "names begin with a letter or digit, go on with letters, digits, '.', '_' or '-', and have at most 64 characters"
)
NONE: Final = "none"
"""What the gripper holds when it holds nothing; no object may be called so (CONTRACT, Names)."""
NODES: Final = frozenset((
    "Action", "AlwaysFailure", "AlwaysSuccess", "AsyncFallback", "AsyncSequence", "Condition", "Control",
    "CountAt", "Decorator", "Delay", "Drop", "Fallback", "FindGrasp", "FindHeld", "FindInTheWay", "FindObject",
    "FindSpot", "FindUnder", "FindUpon", "ForceFailure", "ForceSuccess", "GripperIs", "IfThenElse", "InGripper",
    "Inverter", "KeepRunningUntilFailure", "LoopBool", "LoopDouble", "LoopInt", "LoopString", "ManualSelector",
    "ObjectAt", "ObjectPosedAt", "ObjectRoughlyAt", "Parallel", "ParallelAll", "Pick", "Place", "Precondition",
    "ReactiveFallback", "ReactiveSequence", "Repeat", "RetryUntilSuccesful", "RetryUntilSuccessful", "RunOnce",
    "Script", "ScriptCondition", "Sequence", "SequenceStar", "SequenceWithMemory", "SetBlackboard",
    "SetGripper", "SetSignal", "SignalIs", "SkipUnlessUpdated", "Sleep", "SubTree", "SubTreePlus", "Switch2",
    "Switch3", "Switch4", "Switch5", "Switch6", "Timeout", "TryCatch", "UnsetBlackboard", "UpdateBlackboard",
    "WaitValueUpdate", "WasEntryUpdated", "WhileDoElse",
))  # fmt: skip
"""No tree can have the ID of a node: of those that BehaviorTree.CPP 4 brings along, and those of the contract."""
RESERVED: Final = {"cell": {"artifacts"}, "object": {NONE}, "alias": {"versions"}}
"""`versions` would be hidden by a path of HTTP (CONTRACT, section 5)."""


def check_name(kind: str, name: object) -> str:
    """Return `name` if the contract admits it for `kind` ('cell', 'task', 'user', 'object' or 'frame').

    Raises NameRefusedError otherwise, also for reserved names.
    """
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise NameRefusedError(kind, name, RULE)
    if name in RESERVED.get(kind, ()):
        raise NameRefusedError(kind, name, "this name is reserved")
    return name


def check_alias(name: object) -> str:
    """Return `name` if it may be an alias: a name that starts with a letter. Raises NameRefusedError."""
    check_name("alias", name)
    if not str(name)[0].isalpha():
        raise NameRefusedError("alias", name, "an alias starts with a letter")
    return str(name)


def identifier(name: str) -> str:
    """`name` as an ID of BehaviorTree.CPP: what is not a letter, a digit or '_' becomes '_' (CONTRACT, section 3)."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name)


def distinct_identifiers(names: Iterable[str]) -> dict[str, str]:
    """An ID for each name, no two alike: names that differ only in '.' and '-' get a number behind the second."""
    found: dict[str, str] = {}
    for name in sorted(set(names)):
        candidate, number = identifier(name), 1
        while candidate in found.values():
            number += 1
            candidate = f"{identifier(name)}_{number}"
        found[name] = candidate
    return found
