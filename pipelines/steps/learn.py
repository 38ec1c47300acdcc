"""From the lake to the artifact store: choose demonstrations of a task, learn, publish, set `latest` or `doubtful`."""

from __future__ import annotations

import hashlib
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any, Final

import learner
from learner.learned import Learned
from learner.learning import DEFAULT_METHOD, learn
from learner.model import Demonstration, check_name
from learner.model.doubt import Doubt
from learner.observation import warnings_of
from learner.observation.doubts import doubts_of
from learner.parameters import Parameters
from learner.planning.actions import scene_of
from learner.progress import tell
from learner.stages import UNSEEN, Stages
from pipelines.console import silent_standard_error
from pipelines.errors import CommandError
from pipelines.home import Home
from pipelines.steps.gate import reasons_against, untried
from pipelines.steps.locks import locked
from storage.artifacts import ArtifactStore
from storage.lake import Entry, Lake

POINTS: Final = (
    "no demonstration tells the scene: objects are points, recovery covers only relations seen in demonstrations, "
    "physics checks are left out"
)


@dataclass(frozen=True)
class Choice:
    """Which demonstrations of `task` are learned from, chosen at `chosen_ns`; `left_out` gives the reason by
    demonstration.
    """

    task: str
    demonstrations: tuple[Demonstration, ...]
    left_out: Mapping[str, str]
    chosen_ns: int


@dataclass(frozen=True)
class Publication:
    """What a run of `learn` came to: CONTRACT, section 4, and the learner's notes.

    `doubtful` are the reasons why it is not `latest`; `new` is False where an equal tree was stored before, whose
    version this is.
    """

    task: str
    version: int
    digest: str
    nodes: int
    nodes_recovery: int
    aliases: tuple[str, ...]
    notes: tuple[str, ...]
    doubts: tuple[Doubt, ...]
    doubtful: tuple[str, ...]
    new: bool

    def to_data(self) -> dict[str, Any]:
        """The JSON document of the command."""
        return asdict(self)


@contextmanager
def learning(home: Home, task: str) -> Iterator[None]:
    """Within the block nobody else on this machine learns the task; who does so now is waited for.

    Raises NameRefusedError for a name that is none.
    """
    check_name("task", task)
    with locked(home.lock(f"learn-{task}")):
        yield


def learn_task(
    lake: Lake,
    store: ArtifactStore,
    task: str,
    method: str = DEFAULT_METHOD,
    include_unknown: bool = False,
    include_gaps: bool = False,
    parameters: Parameters | None = None,
    stages: Stages = UNSEEN,
) -> Publication:
    """The whole way for one task: choose, learn and rehearse, publish. Raises what its steps raise."""
    choice = choose(lake, task, include_unknown, include_gaps)
    return publish(store, choice, learn_from(choice, method, parameters, stages), method)


def learn_from(
    choice: Choice,
    method: str = DEFAULT_METHOD,
    parameters: Parameters | None = None,
    stages: Stages = UNSEEN,
) -> Learned:
    """Learn and rehearse; where the scene is known, replay with the arm. Raises NothingLearnedError."""
    if _scene_known(choice):
        with silent_standard_error():
            import learner.simulation.physical_world  # noqa: F401  # takes a fifth of a second, and is rarely needed
    return learn(choice.demonstrations, parameters, method, rehearsed=True, stages=stages)


def choose(lake: Lake, task: str, include_unknown: bool = False, include_gaps: bool = False) -> Choice:
    """The demonstrations of `task` to learn from: those with outcome success that nobody excluded.

    `include_unknown` adds the other outcomes; `include_gaps` those with messages lost near an action. Raises
    NameRefusedError for a name that is none, and CommandError that says what there is where nothing is left.
    """
    check_name("task", task)
    tell(f"reading the demonstrations of {task}")
    chosen_ns = time.time_ns()
    entries = lake.entries(task)
    if not entries:
        raise CommandError(_nothing_shown(lake, task))
    left_out = {
        entry.demonstration.demonstration_id: reason
        for entry in entries
        if (reason := _reason_against(entry, include_unknown, include_gaps))
    }
    chosen = tuple(e.demonstration for e in entries if e.demonstration.demonstration_id not in left_out)
    if not chosen:
        raise CommandError(f"nothing to learn {task} from: {_listing(left_out)}")
    return Choice(task, chosen, left_out, chosen_ns)


def publish(store: ArtifactStore, choice: Choice, learned: Learned, method: str) -> Publication:
    """Store what was learned with its lineage; an equal tree makes no new version.

    A tree of the default method becomes `latest`, or, where there are reasons against it, `doubtful` (CONTRACT, section
    3); one of another method gets only an alias of the method's name.
    """
    tell(f"publishing {choice.task}")
    doubts, notes = doubts_about(choice, learned), notes_of(choice, learned)
    published = store.publish(choice.task, learned.tree, facts_about(choice, learned, method, doubts, notes))
    reasons = reasons_against(learned, doubts)
    if method == DEFAULT_METHOD:
        store.judge(choice.task, published.version, reasons, choice.chosen_ns)
    elif not reasons:
        store.alias(choice.task, method, published.version)
    names = [name for name, version in store.aliases(choice.task).items() if version == published.version]
    return Publication(
        task=choice.task,
        version=published.version,
        digest=published.digest,
        nodes=learned.tree.nodes,
        nodes_recovery=learned.tree.nodes_recovery,
        aliases=tuple(names),
        notes=notes,
        doubts=doubts,
        doubtful=reasons,
        new=published.new,
    )


def facts_about(
    choice: Choice, learned: Learned, method: str, doubts: Sequence[Doubt], notes: Sequence[str]
) -> dict[str, Any]:  # fmt: skip
    """What the manifest says beside what follows from the tree: whence it comes, and what is not known."""
    first, scene = choice.demonstrations[0], scene_of(choice.demonstrations)
    return {
        "base_frame": first.base_frame,
        "end_effector_frame": first.end_effector_frame,
        "lineage": {
            "method": method,
            "parameters": learned.parameters.to_data(),
            "code": code_version(),
            "demonstrations": [_origin(demonstration) for demonstration in _ordered(choice.demonstrations)],
            "left_out": dict(choice.left_out),
        },
        "metrics": {
            "demonstrations": len(choice.demonstrations),
            "users": len({demonstration.user for demonstration in choice.demonstrations}),
            "actions_demonstrated": sum(len(demonstration.actions) for demonstration in choice.demonstrations),
            "nodes": learned.tree.nodes,
            "nodes_recovery": learned.tree.nodes_recovery,
            "nodes_written": learned.tree.nodes_written,
        },
        "scene_known": _scene_known(choice),
        "scene": None if scene is None else scene.to_data(),
        "grasps": [grasp.to_data() for grasp in learned.grasps],
        "certificate": learned.certificate,
        "report": learned.report,
        "notes": list(notes),
        "doubts": [doubt.to_data() for doubt in doubts],
    }


def doubts_about(choice: Choice, learned: Learned) -> tuple[Doubt, ...]:
    """What the demonstrations leave in doubt about the tree (CONTRACT, section 3)."""
    return (*learned.doubts, *doubts_of(_ordered(choice.demonstrations)))


def notes_of(choice: Choice, learned: Learned) -> tuple[str, ...]:
    """What a person should know of this tree: the learner's notes, what was left out, and what stood in for what."""
    left_out = (f"{name} was left out: {reason}" for name, reason in choice.left_out.items())
    points = () if _scene_known(choice) else (POINTS,)
    return (*learned.notes, *untried(learned), *left_out, *points, *_warnings(choice))


def _warnings(choice: Choice) -> list[str]:
    """The warnings of the demonstrations, each once, with those that share it."""
    sharing: dict[str, list[str]] = defaultdict(list)
    for demonstration in _ordered(choice.demonstrations):
        for text in warnings_of(demonstration):
            sharing[text].append(demonstration.demonstration_id)
    return [f"{text} (in {_some(names)})" for text, names in sharing.items()]


def _some(names: Sequence[str], shown: int = 3) -> str:
    """The first few names, and how many more."""
    more = f" and {len(names) - shown} more" if len(names) > shown else ""
    return ", ".join(names[:shown]) + more


@cache
def code_version() -> dict[str, str]:
    """Which code learned: our version, and the digest of the learner's own files, which tells apart what is not.

    Once a process: what it has imported does not change with the files.
    """
    return {"treewright": version_of("treewright"), "learner_sha256": _digest_of(Path(learner.__file__).parent)}


def _digest_of(folder: Path) -> str:
    digest = hashlib.sha256()
    for file in sorted(folder.rglob("*.py")):
        digest.update(f"{file.relative_to(folder).as_posix()}\0".encode() + file.read_bytes() + b"\0")
    return digest.hexdigest()


def _origin(demonstration: Demonstration) -> dict[str, Any]:
    return {
        "demonstration_id": demonstration.demonstration_id,
        "sha256": demonstration.sha256,
        "user": demonstration.user,
        "cell": demonstration.cell,
        "outcome": demonstration.outcome,
    }


def _ordered(demonstrations: Iterable[Demonstration]) -> Sequence[Demonstration]:
    return sorted(demonstrations, key=lambda demonstration: demonstration.demonstration_id)


def _scene_known(choice: Choice) -> bool:
    return any(demonstration.scene is not None for demonstration in choice.demonstrations)


def _reason_against(entry: Entry, include_unknown: bool, include_gaps: bool) -> str | None:
    demonstration = entry.demonstration
    if entry.excluded:
        return "it is excluded (`treewright demos restore` takes it back)"
    if demonstration.outcome != "success" and not include_unknown:
        return f"its outcome is {demonstration.outcome} (--include-unknown learns from it)"
    if demonstration.gaps and not include_gaps:
        return f"messages were lost near an action (--include-gaps learns from it): {demonstration.gaps[0]}"
    return None


def _nothing_shown(lake: Lake, task: str) -> str:
    tasks = sorted({demonstration.task for demonstration in lake.demonstrations(include_excluded=True)})
    shown = f"there are demonstrations of {', '.join(tasks)}" if tasks else "the lake is empty: ingest recordings first"
    return f"no demonstration of the task {task}; {shown}"


def _listing(left_out: Mapping[str, str]) -> str:
    """The first few reasons, as one sentence."""
    shown = [f"{name}: {reason}" for name, reason in list(left_out.items())[:3]]
    more = f"; and {len(left_out) - 3} more" if len(left_out) > 3 else ""
    return "; ".join(shown) + more
