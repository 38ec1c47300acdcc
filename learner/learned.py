"""What a method returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from learner.model import Tree
from learner.model.doubt import Doubt
from learner.parameters import Parameters
from learner.relations.grasping import Grasp

if TYPE_CHECKING:  # the draft is only named here
    from learner.planning.draft import Draft


@dataclass(frozen=True)
class Learned:
    """A tree, a report for the manifest (JSON-able), and notes: sentences on what is not known or was left out."""

    tree: Tree
    report: dict[str, Any]
    notes: tuple[str, ...]
    parameters: Parameters = field(repr=False, compare=False)
    """The numbers by which it was learned."""
    certificate: dict[str, Any] | None = None
    """What was proven of the tree: see learner.proof.prover.Certificate."""
    doubts: tuple[Doubt, ...] = ()
    """What the demonstrations have in common and the tree does not reproduce."""
    grasps: tuple[Grasp, ...] = ()
    """How objects are grasped that no node of the tree says it of."""
    draft: Draft | None = field(default=None, repr=False, compare=False)
    """Where the method can make the tree again with repairs: from what."""
