"""What a tree of vocabulary 2 is answered by beside what is seen: how things are grasped, and which places it names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from learner.model.query import Site, sites_of
from learner.model.tree import Node, is_reference
from learner.relations.grasping import Grasp


@dataclass(frozen=True)
class Knowledge:
    """`grasps` as the manifest lists them; `places` are left free by what is put aside."""

    grasps: tuple[Grasp, ...] = ()
    places: tuple[Site, ...] = ()

    @staticmethod
    def of(root: Node, grasps: Iterable[Grasp]) -> Knowledge:
        """That of a flattened tree."""
        return Knowledge(tuple(grasps), tuple(dict.fromkeys(_places_of(root))))


UNKNOWING: Final = Knowledge()


def _places_of(root: Node) -> Iterator[Site]:
    """The places of a tree's conditions, and those of its `at` and `not_at`."""
    for node in root.walk():
        ports = {name: value for name, value in node.ports if not is_reference(value)}
        for text in (ports.get("at"), ports.get("not_at")):
            yield from sites_of(str(text or ""))
        if {"frame", "position", "radius"} <= ports.keys():
            yield Site(str(ports["frame"]), ports["position"], float(ports["radius"]))  # type: ignore[arg-type]  # checked by Tree
