"""The published method, plain: cluster, infer constraints and goals, backchain (paper, section III).

Kept beside ours as `--method paper`. Where the paper is silent it does what the authors' code was measured to do:
see PaperParameters. Known to fail in ways that learner.treewright repairs.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np

from learner.inference.clustering import Cluster, clusters_in_frame
from learner.inference.dbscan import dbscan
from learner.inference.samples import Samples
from learner.learned import Learned
from learner.model import Action, Definition, Demonstration, Drop, Pick, Place, SetGripper, Tree
from learner.model.condition import GripperState
from learner.model.tree import fallback
from learner.paper.backchaining import Operator, PlannedTree, Planner
from learner.paper.constraints import goals, guards
from learner.paper.parameters import PaperParameters
from learner.parameters import Parameters
from learner.planning.rounding import rounded_pose, rounded_vector
from learner.planning.synthesis import main_id
from learner.stages import UNSEEN, Stages

Identity = tuple[Any, ...]
"""What makes two demonstrated actions equal: type, object, and the clusters that they lie in."""


def learn_plainly(demonstrations: Sequence[Demonstration], parameters: Parameters, stages: Stages = UNSEEN) -> Learned:
    """The tree of the published method.

    Nothing is refused: where conditions conflict so that the planner does not reach a group's goal in its own
    simulator, the tree is the one that it grew until then, as the published code's is, and a note says so.
    """
    numbers = parameters.paper
    samples = Samples.of(demonstrations)
    identities, clusters = stages.run("cluster", lambda: identify(samples, len(demonstrations), numbers))
    members: dict[Identity, list[int]] = defaultdict(list)
    for row, identity in enumerate(identities):
        members[identity].append(row)
    actions = {key: _action(samples[np.array(rows)], clusters.get(key), numbers) for key, rows in members.items()}
    sequences: list[list[Identity]] = [[] for _ in demonstrations]
    for number, identity in zip(samples.demonstration, identities, strict=True):
        sequences[number].append(identity)
    groups = stages.run("infer", lambda: _groups(sequences, actions))
    plans = stages.run("plan", lambda: [_plan(group, actions, numbers) for group in groups])
    roots = [plan.root for plan in plans]
    root = roots[0] if len(roots) == 1 else fallback(*roots, reactive=False)
    shown = [sorted(_members(group, sequences, demonstrations)) for group in groups]
    report = {
        "groups": [{"demonstrations": m, "reached": p.reached} for m, p in zip(shown, plans, strict=True)],
        "actions": [_describe(action) for action in sorted(actions.values(), key=repr)],
    }
    notes = tuple(_unreached(m) for m, plan in zip(shown, plans, strict=True) if not plan.reached)
    return Learned(Tree(Definition(main_id(demonstrations), root)), report, notes, parameters)


def _unreached(members: Sequence[str]) -> str:
    others = f" and {len(members) - 1} more like it" if len(members) > 1 else ""
    return (
        f"the conditions learned from demonstration {members[0]}{others} conflict: their goal is not reached in the"
        " planner's own simulator; use method treewright, or leave such demonstrations out"
    )


def identify(
    samples: Samples, demonstrations: int, numbers: PaperParameters
) -> tuple[list[Identity], dict[Identity, Cluster]]:
    """The identity of every sample, and the cluster of every identity that has one (section III-E)."""
    classes: dict[tuple[str, str], list[int]] = defaultdict(list)
    for number, kind_and_name in enumerate(zip(samples.type.tolist(), samples.object.tolist(), strict=True)):
        classes[kind_and_name].append(number)
    identities: list[Identity] = [()] * len(samples)
    best: dict[Identity, Cluster] = {}
    for (kind, name), members in sorted(classes.items()):
        memberships = _memberships(samples, members, numbers.samples_for(demonstrations), numbers.eps_m)
        for number in members:
            ranked = memberships[number]
            identity: Identity = (kind, name, "alone", number)
            if ranked:
                context = ranked[1:2] if _tells_contexts(ranked, demonstrations, numbers) else []
                identity = (kind, name, *((c.frame, c.members) for c in (ranked[0], *context)))
                best[identity] = ranked[0]
            identities[number] = identity
    return identities, best


def _memberships(samples: Samples, members: Sequence[int], min_samples: int, eps_m: float) -> dict[int, list[Cluster]]:
    """For each sample the clusters that it lies in, the best first; of equal ones that in the base, then by frame."""
    found: dict[int, list[Cluster]] = {number: [] for number in members}
    rows = np.array(members, dtype=np.intp)
    for frame in samples[rows].frames:
        known = rows[samples.candidate(frame)[rows]]
        points = samples.target(frame).positions[known]
        for cluster in clusters_in_frame(frame, known, points, dbscan(points, eps_m, min_samples)):
            for number in cluster.members:
                found[number].append(cluster)
    return {number: sorted(of, key=lambda c: -c.score) for number, of in found.items()}


def _tells_contexts(ranked: Sequence[Cluster], demonstrations: int, numbers: PaperParameters) -> bool:
    return len(ranked) > 1 and ranked[1].score >= numbers.context_score_per_demonstration * demonstrations


def _action(samples: Samples, cluster: Cluster | None, numbers: PaperParameters) -> Action:
    """The action that these samples show; what it achieves is the mean of the rests.

    Executed is what the reference code executes: the mean position of the picks, and of one of the placements its own;
    there it is drawn anew each time, here it is the first, as is the orientation.
    """
    frame = cluster.frame if cluster else samples.base
    target = rounded_pose(samples.target(frame).pose(0))
    kind, name = str(samples.type[0]), str(samples.object[0])
    if kind == "pick":
        return Pick(name, frame, rounded_vector(samples.target(frame).positions.mean(axis=0)), target.quaternion_xyzw)
    rest = rounded_vector(samples.rest(frame).positions.mean(axis=0))
    if kind == "place":
        return Place(name, frame, target.position, target.quaternion_xyzw, rest, numbers.place_radius_m)
    return Drop(name, frame, target.position, target.quaternion_xyzw, rest, numbers.drop_radius_m)


def _groups(
    sequences: Sequence[Sequence[Identity]], actions: dict[Identity, Action]
) -> list[list[Sequence[Identity]]]:  # fmt: skip
    """Demonstrations with equal goals, the larger group first, then the one seen first."""
    groups: dict[frozenset[Any], list[Sequence[Identity]]] = defaultdict(list)
    for sequence in sequences:
        groups[frozenset(goals(sequence, actions))].append(sequence)
    return sorted(groups.values(), key=lambda group: -len(group))


def _plan(
    group: Sequence[Sequence[Identity]], actions: dict[Identity, Action], numbers: PaperParameters
) -> PlannedTree:
    """The planner's tree for one group; its operators come in the order in which they were demonstrated."""
    used = dict.fromkeys(key for sequence in group for key in sequence)
    costs = {Pick: numbers.pick_cost, Place: numbers.place_cost, Drop: numbers.place_cost}
    operators = [
        Operator(
            actions[key],
            (*guards(key, actions, group), *sorted(actions[key].preconditions, key=repr)),
            actions[key].postconditions,
            costs[type(actions[key])],
        )
        for key in used
    ]
    states: tuple[GripperState, ...] = ("open", "closed")
    for state in states:
        action = SetGripper(state)
        operators.append(Operator(action, (), action.postconditions, numbers.set_gripper_cost))
    return Planner(goals(group[0], actions), operators, numbers.rollouts).plan()


def _members(
    group: Sequence[Sequence[Identity]],
    sequences: Sequence[Sequence[Identity]],
    demonstrations: Sequence[Demonstration],
) -> list[str]:
    inside = {id(sequence) for sequence in group}
    return [
        demonstration.demonstration_id
        for sequence, demonstration in zip(sequences, demonstrations, strict=True)
        if id(sequence) in inside
    ]


def _describe(action: Action) -> dict[str, Any]:
    known = None if isinstance(action, SetGripper) else action
    return {
        "type": type(action).__name__,
        "object": known.object if known else None,
        "frame": known.frame if known else None,
    }
