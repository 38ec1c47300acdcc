"""What is settled before a cell moves: which tree, in which frames, and that the cell has all that it needs."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from learner.errors import ModelError
from learner.execution.entries import Found
from learner.execution.perception import CellState, condition_of, query_of
from learner.execution.ticking import Status, Ticker
from learner.model.frame import objects_of
from learner.model.names import check_name
from learner.model.scene import Scene
from learner.model.tree import Node, Tree
from learner.model.vocabulary import ACTIONS
from learner.relations.answering import Answering
from learner.relations.grasping import Grasp
from learner.relations.knowledge import Knowledge
from pipelines.controller.cell_link import CellLink
from pipelines.controller.controller import described
from pipelines.errors import CellRefusedError, CommandError, UnreachableError
from pipelines.home import Home
from pipelines.reference import Reference
from storage.btcpp import from_xml
from storage.client import fetch
from storage.errors import DamagedError, StorageUnavailableError

if TYPE_CHECKING:
    import zenoh

STORE_ANSWERS_S: Final = 5.0
"""A store that was not heard of for this long [s] after the session was opened does not answer."""
CELL_SHOWS_S: Final = 3.0
"""What a running cell has not shown within this time [s] it does not have."""
LOOK_AGAIN_S: Final = 0.05
DATABASE: Final = "store.sqlite"
DOUBTFUL: Final = "doubtful"
"""The alias by which alone a tree is run of which something is doubted."""


@dataclass(frozen=True)
class Job:
    """A tree to execute, flattened, and the frames in which its poses are meant."""

    task: str
    name: str
    digest: str
    tree: Tree
    root: Node
    base_frame: str
    end_effector_frame: str
    scene: Scene
    """The shapes of the objects, where they were known: by them the cell knows what it holds, and what looks alike."""
    grasps: tuple[Grasp, ...] = ()
    """Where FindGrasp is answered from."""

    @staticmethod
    def of(task: str, tree: Tree, manifest: Mapping[str, Any]) -> Job:
        """Raises DamagedError if the tree is not the manifest's or its scene is none, CommandError if the manifest
        leaves out a frame.
        """
        name = f"{task}@{manifest.get('version')}"
        if tree.digest != manifest.get("digest"):
            raise DamagedError(f"the tree of {name} does not have the digest that its manifest states")
        frames = {key: manifest.get(key) for key in ("base_frame", "end_effector_frame")}
        unset = [key for key, value in frames.items() if value is None]
        if unset:
            raise CommandError(f"the manifest of {name} does not state its {' and '.join(unset)}; learn it again")
        base, end_effector = (check_name("frame", value) for value in frames.values())
        scene, grasps = _scene(name, manifest.get("scene")), _grasps(name, manifest.get("grasps"))
        return Job(task, name, tree.digest, tree, tree.flattened(), base, end_effector, scene, grasps)

    def empty_state(self) -> CellState:
        """The state of a cell of which nothing was seen yet."""
        answering = Answering(self.scene, Knowledge.of(self.root, self.grasps))
        return CellState(self.base_frame, self.end_effector_frame, answering)

    @property
    def nodes(self) -> int:
        """The size of the flattened tree, recovery included."""
        return self.root.size

    @property
    def needs(self) -> dict[str, str]:
        """What must be seen in the cell: names, each with what it is to the tree."""
        names = {name for frame in self.tree.frames() for name in objects_of(frame)}
        frames = dict.fromkeys(sorted(names - {self.base_frame}), "frame")
        objects = dict.fromkeys(sorted(self.tree.objects()), "object")
        return {self.end_effector_frame: "end-effector frame", **frames, **objects}

    @property
    def skills(self) -> list[str]:
        """The actions of the tree, and what stops them."""
        return [*sorted({node.kind for node in self.root.walk() if node.kind in ACTIONS}), "cancel"]

    def await_cell(self, link: CellLink, stop: threading.Event, limit_s: float = CELL_SHOWS_S) -> None:
        """Wait until the cell has shown all that the tree needs.

        Raises UnreachableError if nothing is heard of the cell, CellRefusedError naming what it lacks, CommandError
        if `stop` is set before.
        """
        deadline_s = time.monotonic() + limit_s
        while self._lacking(link) and time.monotonic() < deadline_s:
            if stop.wait(LOOK_AGAIN_S):
                raise CommandError("stopped before anything moved")
            link.take_in()
        lacking = self._lacking(link)
        if lacking:
            raise self._refusal(link, lacking, limit_s)

    def _lacking(self, link: CellLink) -> list[str]:
        state = link.state
        unseen = [f"the {what} {name!r}" for name, what in self.needs.items() if state.unseen(name)]
        gripper = ["a gripper state"] if state.gripper is None else []
        signals = [f"the signal {name!r}" for name in sorted(self.tree.signals()) if name not in state.signals]
        kinds = [f"an object of kind {kind!r}" for kind in sorted(self.tree.kinds()) if not self._shown(kind, link)]
        skills = [f"the skill {skill}" for skill in self.skills if not link.offers(skill)]
        return [*unseen, *gripper, *signals, *kinds, *skills]

    def _shown(self, kind: str, link: CellLink) -> bool:
        """Whether anything of a kind is seen."""
        of_kind = (name for name, shape in self.scene.objects.items() if shape.kind == kind)
        return any(not link.state.unseen(name) for name in of_kind)

    def _refusal(self, link: CellLink, lacking: list[str], limit_s: float) -> CommandError:
        seen, state = ", ".join(link.state.poses()), link.state
        if not seen and state.gripper is None and not link.parents:
            return UnreachableError(
                f"cell {link.cell!r} publishes nothing below treewright/{link.cell}; is it running and reachable?"
            )
        if not seen and link.parents:
            parents = ", ".join(repr(parent) for parent in sorted(link.parents))
            return CellRefusedError(
                f"cell {link.cell!r} lacks the base frame {self.base_frame!r} of {self.name}: "
                f"its poses are in {parents}"
            )
        complaints = f"; it {link.complaints[0].partition(' publishes ')[2]}" if link.complaints else ""
        return CellRefusedError(
            f"cell {link.cell!r} lacks {', '.join(lacking)} of {self.name} (within {limit_s:g} s); "
            f"seen are {seen or 'no poses'}{complaints}"
        )


def _scene(name: str, scene: Any) -> Scene:
    """Of a manifest; without any object where it tells none, as those of earlier versions do."""
    try:
        return Scene({}) if scene is None else Scene.of_data(scene)
    except ValueError as error:
        raise DamagedError(f"in the manifest of {name} {error}") from error


def _grasps(name: str, grasps: Any) -> tuple[Grasp, ...]:
    """Of a manifest; none where it tells none."""
    try:
        return tuple(map(Grasp.of_data, grasps or ()))
    except (KeyError, TypeError, ValueError, ModelError) as error:
        raise DamagedError(f"in the manifest of {name} the grasps are not as the contract has them: {error}") from error


def from_zenoh(session: zenoh.Session, reference: Reference, stop: threading.Event) -> Job:
    """The tree that a served store answers with.

    A session learns of its peers a little after it was opened: until the limit, no answer means not yet.
    """
    deadline_s = time.monotonic() + STORE_ANSWERS_S
    while True:
        try:
            xml, manifest = fetch(session, reference.task, reference.version, reference.alias)
            _check_undoubted(reference, manifest)
            return Job.of(reference.task, from_xml(xml), manifest)
        except StorageUnavailableError:
            if time.monotonic() >= deadline_s or stop.wait(LOOK_AGAIN_S):
                raise


def from_store(root: Path, url: str | None, reference: Reference) -> Job:
    """The tree in the store in the folder `root`, which may also be the data root that has the store in it.

    Its database is at `url` where `root` has none. Raises CommandError if there is no such store.
    """
    from storage.artifacts import ArtifactStore  # loads the database's library, which a fetch over Zenoh does not need

    inside = Home(root).store
    folder = inside if inside.is_dir() and not (root / DATABASE).exists() else root
    own = (folder / DATABASE).exists()
    if not own and url is None:
        raise CommandError(
            f"there is no artifact store in {root}; learn {reference.task} first, or name another --store"
        )
    with ArtifactStore(folder, None if own else url) as store:
        artifact = store.get(reference.task, reference.alias if reference.version is None else reference.version)
    _check_undoubted(reference, artifact.standing.to_data() | {"version": artifact.version})
    return Job.of(reference.task, artifact.tree, artifact.manifest)


def _check_undoubted(reference: Reference, served: Mapping[str, Any]) -> None:
    """Raises CommandError for a tree that is doubtful and was not asked for as such (CONTRACT, section 3)."""
    reasons = served.get("doubtful")
    if reasons and reference.alias != DOUBTFUL:
        name = f"{reference.task}@{served.get('version')}"
        raise CommandError(
            f"{name} is doubtful: {reasons[0]}; run it as {reference.task}@{DOUBTFUL}, or "
            f"`treewright approve {name} --by NAME`"
        )


def first_action(root: Node, state: CellState) -> tuple[str, str | None]:
    """The status of one tick in which nothing moves, and the first action that it would have started."""
    leaves = _Still(state)
    status = Ticker(root, leaves).tick()
    return status.value, leaves.wanted


class _Still:
    """Leaves that check the cell and stop at the first action."""

    def __init__(self, state: CellState) -> None:
        self._state = state
        self.wanted: str | None = None

    def check(self, node: Node) -> bool:
        return self._state.holds(condition_of(node))

    def find(self, node: Node) -> Found | None:
        return self._state.find(query_of(node))

    def tick_action(self, node: Node) -> Status:
        self.wanted = described(node)
        return Status.RUNNING

    def halt_action(self, node: Node) -> None:
        """Nothing moves."""
