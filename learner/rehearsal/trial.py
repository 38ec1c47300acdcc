"""The trial of what was learned, before it is published: rehearsed, repaired, proven, and replayed with the arm."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import count
from types import TracebackType
from typing import Any, Self

import numpy as np

from learner.errors import NothingLearnedError
from learner.inference.understanding import understand
from learner.learned import Learned
from learner.model import Demonstration, Tree
from learner.planning.draft import Draft
from learner.planning.repairs import NOTHING, Repairs
from learner.progress import tell
from learner.proof.prover import Certificate, prove
from learner.rehearsal.arm_replay import Replay, replay
from learner.rehearsal.beside import Beside
from learner.rehearsal.goal import goals_of
from learner.rehearsal.lessons import Candidate, Lessons, candidates
from learner.rehearsal.rehearsal import Rehearsal, RolloutResult, rehearse
from learner.rehearsal.share import Share
from learner.rehearsal.stage import Stage
from learner.rehearsal.users import success_without
from learner.relations.things import NO_THINGS
from learner.stages import UNSEEN, Stages


def certify(learned: Learned, base_frame: str) -> Learned:
    """With the certificate of its tree, and a note if there is a counterexample."""
    certificate = _certificate(learned, learned.tree, base_frame)
    return replace(learned, certificate=certificate.to_data(), notes=(*learned.notes, *_unproven(certificate)))


def rehearse_and_repair(learned: Learned, demonstrations: Sequence[Demonstration], stages: Stages = UNSEEN) -> Learned:
    """With the best of the trees that a draft makes, once rehearsed and repaired, that is proven; else the first.

    A method without a draft has its tree judged by what ours understands of the demonstrations, and not repaired.
    """
    base_frame, parameters = demonstrations[0].base_frame, learned.parameters
    try:
        draft = learned.draft or Draft(understand(demonstrations, parameters.inference), parameters.planning, {})
    except NothingLearnedError as error:
        told = {"rehearsal": {"rollouts": 0, "reason": str(error)}, "replay": Replay(reason=str(error)).to_data()}
        return certify(replace(learned, report={**learned.report, **told}), base_frame)
    with _Trial(learned, draft, Stage(demonstrations, parameters.rehearsal), stages) as trial:
        return trial.learned()


@dataclass(frozen=True)
class _Tried:
    candidate: Candidate
    certificate: Certificate
    replay: Replay

    @property
    def better(self) -> tuple[bool, int, float]:
        """What makes one preferable to another, the most important first."""
        proven = self.certificate.counterexample is None
        return proven, -len(self.replay.failures), float(self.candidate.rehearsal.share)


class _Trial:
    """The trial of one method's tree on a stage. A context manager: what does not wait for the rehearsal of the first
    tree, which is seldom repaired, is done beside.
    """

    def __init__(self, learned: Learned, draft: Draft, stage: Stage, stages: Stages) -> None:
        self.first, self.draft, self.stage, self.stages = learned, draft, stage, stages
        self.numbers = stage.parameters.lessons
        self.goals = partial(goals_of, draft.understood.groups, draft.placements)
        self._replay = Beside(lambda: replay(learned.tree, stage, self.goals, learned.grasps))
        self._proof = Beside(lambda: _certificate(learned, learned.tree, stage.base))
        self._users = Beside(lambda: success_without(draft, stage) if learned.draft else {})

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for work in (self._replay, self._proof, self._users):
            work.end()

    def learned(self) -> Learned:
        """What is published."""
        best, users = self._best(), self._users.result
        report = {
            **self.first.report,
            "rehearsal": {**best.candidate.rehearsal.to_data(), "repairs": best.candidate.repairs.sentences()},
            "replay": best.replay.to_data(),
            "users": [_with_success(user, users[user["user"]]) for user in self.first.report.get("users", ())],
        }
        certificate = best.certificate.to_data()
        if best.replay.failed:
            certificate["counterexample"] = certificate["counterexample"] or f"replayed {best.replay.failures[0]}"
        notes = (
            *self.first.notes,
            *_unproven(best.certificate),
            *_left_out(self.stage),
            *_said(best),
            *_unlike(self.first.report.get("users", ()), users),
        )
        return replace(self.first, tree=best.candidate.tree, report=report, notes=notes, certificate=certificate)

    def _best(self) -> _Tried:
        """The best candidate; if its replay fails, what that teaches is tried too."""
        found = self.stages.run("rehearse", self._candidates)
        best = self._best_proven(found)
        seen = self._proposed(best.replay.failures, best.candidate.repairs)
        repairs = best.candidate.repairs | (seen[-1] if seen else NOTHING)
        if repairs == best.candidate.repairs:
            return best
        tree = self._made(repairs)
        rehearsal = self.stages.run("rehearse", lambda: self._rehearsed(tree))
        other = self._completed(Candidate(tree, repairs, rehearsal))
        return max(best, other, key=lambda one: one.better)

    def _candidates(self) -> list[Candidate]:
        made = count()

        def rehearsed(tree: Tree) -> Rehearsal:
            self.stages.progress(next(made), self.numbers.trials + 1)
            return self._rehearsed(tree)

        return candidates(self.first.tree, self._made, rehearsed, self._proposed, self.numbers.trials)

    def _best_proven(self, found: Sequence[Candidate]) -> _Tried:
        """The best rehearsed candidate if it is proven, or if the first is not proven either; else the first."""
        first, best = found[0], found[-1]
        certificate = self._proven(best.tree)
        if certificate.counterexample is None or best is first:
            return self._completed(best, certificate)
        other = self._proven(first.tree)
        one_proven = other.counterexample is None
        return self._completed(first, other) if one_proven else self._completed(best, certificate)

    def _completed(self, candidate: Candidate, certificate: Certificate | None = None) -> _Tried:
        return _Tried(candidate, certificate or self._proven(candidate.tree), self._replayed(candidate.tree))

    def _proven(self, tree: Tree) -> Certificate:
        if tree is self.first.tree:
            return self.stages.run("prove", lambda: self._proof.result)
        return self.stages.run("prove", lambda: _certificate(self.first, tree, self.stage.base))

    def _replayed(self, tree: Tree) -> Replay:
        if tree is self.first.tree:
            return self.stages.run("replay", lambda: self._replay.result)
        return self.stages.run("replay", lambda: replay(tree, self.stage, self.goals, self.first.grasps))

    def _made(self, repairs: Repairs) -> Tree:
        return self.draft.tree(repairs)

    def _rehearsed(self, tree: Tree) -> Rehearsal:
        return rehearse(tree, self.stage, self.goals(self.stage), grasps=self.first.grasps)

    def _proposed(self, failures: Sequence[RolloutResult], known: Repairs) -> Sequence[Repairs]:
        return self._lessons.of(failures, known) if self.first.draft else ()

    @cached_property
    def _lessons(self) -> Lessons:
        return Lessons(
            self.draft.placements,
            self.draft.orders,
            self.goals(self.stage),
            self.stage.bodies,
            self.numbers,
        )


def _certificate(learned: Learned, tree: Tree, base_frame: str) -> Certificate:
    """The proof that the tree reaches what it says, and, where there is a draft, that this is the draft's goal."""
    tell("proving the tree")
    draft, numbers = learned.draft, learned.parameters
    goal, things = (draft.goal, draft.things) if draft else (None, NO_THINGS)
    rng, levels = np.random.default_rng(0), numbers.planning.recovery.levels
    return prove(tree, base_frame, rng, goal, numbers.proof, at_once=False, levels=levels, things=things)


def _unproven(certificate: Certificate) -> tuple[str, ...]:
    if certificate.counterexample is None:
        return ()
    return (f"the tree is not proven: from a state with {certificate.counterexample}",)


def _with_success(user: Mapping[str, Any], share: Share | None) -> dict[str, Any]:
    return {**user, "success_without": None if share is None else str(share)}


def _unlike(users: Sequence[Mapping[str, Any]], success: Mapping[str, Share | None]) -> list[str]:
    """Warn about users whom the others' tree reproduces in fewer than half of their starts, once for each user."""
    silent = [user["user"] for user in users if not user["sentence"]]
    shares = ((name, share) for name in silent if (share := success[name]) is not None)
    return [
        f"the tree of the others does what user {name} did from {share} starts"
        for name, share in shares
        if float(share) < 0.5
    ]


def _left_out(stage: Stage) -> list[str]:
    """A sentence for each reason for which demonstrations cannot be set up in simulation, the most frequent first."""
    reasons = Counter(stage.left_out.values()).most_common()
    return [
        f"left out of the rehearsal, {count} demonstration{'s' if count > 1 else ''}: {reason}"
        for reason, count in reasons
    ]


def _said(best: _Tried) -> tuple[str, ...]:
    """Sentences on what still fails in simulation."""
    failures, share = best.candidate.rehearsal.failures, best.candidate.rehearsal.share
    said = [f"rehearsal: {share} done; {failures[0]}"] if failures else []
    said += [f"replay: {best.replay.failures[0]}"] if best.replay.failures else []
    return tuple(said)
