"""What came out of each stage of learning, in a sentence for its log."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from learner.inference.targets import Target
from learner.inference.understanding import Understanding
from learner.learned import Learned
from learner.proof.prover import Certificate
from learner.rehearsal.arm_replay import Replay
from learner.rehearsal.lessons import Candidate
from learner.rehearsal.rehearsal import Rehearsal
from pipelines.steps.learn import Choice, Publication

SHOWN: Final = 4


def sentence_on(result: object) -> str:
    """The sentence on what a stage returned; of what only the published method returns, that it is done."""
    if isinstance(result, list):
        result = tuple(result)
    kind = type(result[0]) if isinstance(result, tuple) and result else type(result)
    return SENTENCES[kind](result) if kind in SENTENCES else "done"


def _choice(choice: Choice) -> str:
    users = len({demonstration.user for demonstration in choice.demonstrations})
    left_out = f"; {_count(len(choice.left_out), 'other')} left out" if choice.left_out else ""
    return f"{_count(len(choice.demonstrations), 'demonstration')} of {_count(users, 'user')}{left_out}"


def _targets(targets: Sequence[Target]) -> str:
    each = [f"{t.object} in the frame {t.frame} ({_count(len(t.members), 'time')})" for t in targets]
    return f"{_count(len(each), 'place')} where something is put: {_listed(each)}"


def _understanding(understood: Understanding) -> str:
    orders = [" then ".join(f"{s.target.object} at {s.target.frame}" for s in g.subgoals) for g in understood.groups]
    strange = f"; {_count(len(understood.strange), 'move')} not part of the task" if understood.strange else ""
    return f"{_count(len(orders), 'group')} of demonstrations: {_listed(orders) or 'nothing is to be done'}{strange}"


def _learned(learned: Learned) -> str:
    tree, asked = learned.tree, learned.report.get("questions", ())
    questions = f"; {_count(len(asked), 'question')} to the operator" if asked else ""
    return f"a tree of {_count(tree.nodes, 'node')}, and {tree.nodes_recovery} that only recover{questions}"


def _candidates(found: Sequence[Candidate]) -> str:
    first, last = found[0].rehearsal.share, found[-1].rehearsal.share
    repaired = f", {first} before it was repaired" if len(found) > 1 else ""
    return f"done in {last} rollouts{repaired}"


def _certificate(certificate: Certificate) -> str:
    if certificate.counterexample is not None:
        return f"not proven: from a state with {certificate.counterexample}"
    return f"proven from {_count(certificate.states, 'state')}"


def _replay(replay: Replay) -> str:
    done = sum(result.done for result in replay.results)
    return replay.reason or f"the simulated arm did it in {done} of {_count(len(replay.results), 'run')}"


def _publication(publication: Publication) -> str:
    novelty = "new" if publication.new else "stored before"
    aliases = ", ".join(publication.aliases) or "no alias"
    doubts = f"; doubtful: {publication.doubtful[0]}" if publication.doubtful else ""
    return f"{publication.task}@{publication.version}, {novelty}, {aliases}{doubts}"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _listed(sentences: Sequence[str]) -> str:
    more = f" and {len(sentences) - SHOWN} more" if len(sentences) > SHOWN else ""
    return ", ".join(sentences[:SHOWN]) + more


SENTENCES: Final[Mapping[type, Callable[[Any], str]]] = {
    Choice: _choice,
    Target: _targets,
    Understanding: _understanding,
    Learned: _learned,
    Candidate: _candidates,
    Rehearsal: lambda rehearsal: f"done in {rehearsal.share} rollouts",
    Certificate: _certificate,
    Replay: _replay,
    Publication: _publication,
}
