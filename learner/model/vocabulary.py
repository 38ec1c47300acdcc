"""The nodes of a tree and their ports, exactly as CONTRACT, section 3, has them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

POSE: Final = ("object", "frame", "position", "orientation")
SPOT: Final = ("object", "frame", "position", "radius")
FIRST_CONDITIONS: Final[Mapping[str, tuple[str, ...]]] = {
    "GripperIs": ("state",),
    "InGripper": ("object",),
    "ObjectAt": SPOT,
    "ObjectRoughlyAt": SPOT,
}
FIRST_ACTIONS: Final[Mapping[str, tuple[str, ...]]] = {
    "Pick": POSE,
    "Place": POSE,
    "Drop": POSE,
    "SetGripper": ("state",),
}
"""Vocabulary 1."""
QUERIES: Final[Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]]] = {
    "FindObject": (("kind", "at", "not_at"), ("object",)),
    "FindUpon": (("object",), ("found",)),
    "FindUnder": (("object",), ("found",)),
    "FindInTheWay": (("object", "frame", "position"), ("found",)),
    "FindHeld": ((), ("object",)),
    "FindSpot": (("object",), ("position", "orientation")),
    "FindGrasp": (("object",), ("position", "orientation")),
}
"""The conditions of vocabulary 2 that write what they find: their input ports, and their output ports."""
SECOND_CONDITIONS: Final[Mapping[str, tuple[str, ...]]] = {
    "ObjectPosedAt": (*SPOT, "orientation", "angle"),
    "SignalIs": ("signal", "value"),
    "CountAt": ("kind", "at", "count"),
    **{kind: (*inputs, *outputs) for kind, (inputs, outputs) in QUERIES.items()},
}
SECOND_ACTIONS: Final[Mapping[str, tuple[str, ...]]] = {"SetSignal": ("signal", "value")}
SECOND: Final = frozenset((*SECOND_CONDITIONS, *SECOND_ACTIONS))
"""The nodes of vocabulary 2."""
CONDITIONS: Final = {**FIRST_CONDITIONS, **SECOND_CONDITIONS}
ACTIONS: Final = {**FIRST_ACTIONS, **SECOND_ACTIONS}
LEAVES: Final = {**CONDITIONS, **ACTIONS}
SEQUENCES: Final = ("Sequence", "ReactiveSequence")
FALLBACKS: Final = ("Fallback", "ReactiveFallback")
DECORATORS: Final = ("Inverter", "ForceSuccess", "ForceFailure")
SUBTREE: Final = "SubTree"
RECOVERY_PREFIX: Final = "Recover_"
PORT_KINDS: Final[Mapping[str, str]] = {"object": "name", "frame": "name", "found": "name"}
"""Ports whose values are exchangeable: an object may serve as a frame, what was found as an object."""
LENGTHS: Final = {"position": 3, "orientation": 4}
"""Ports that hold so many numbers."""
SCALARS: Final = ("radius", "angle")
"""Ports that hold one number."""
REFERENCE: Final = re.compile(r"\{([A-Za-z_][A-Za-z0-9_]*)\}", re.ASCII)
"""A port that refers to a port of its SubTree, or to an entry that an earlier node of it has written."""
ENTRY: Final = re.compile(r"\{[A-Za-z_][A-Za-z0-9_]*\.[0-9]+\}", re.ASCII)
"""The same in a flattened tree: an entry of one use of a SubTree."""


def outputs_of(kind: str) -> tuple[str, ...]:
    """The ports that a node writes."""
    return QUERIES[kind][1] if kind in QUERIES else ()


def port_kind(port: str) -> str:
    """What a port holds: ports of one kind can hold each other's values."""
    return PORT_KINDS.get(port, port)
