"""The page on which a person lets the robot work: start, what it does while it does it, and Stop."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping
from typing import Any, Final

from nicegui import ui

from learner.errors import LearnerError
from pipelines.errors import CommandError
from pipelines.panel.desk import Desk
from pipelines.panel.folding import Folding, Told
from pipelines.panel.pages.frame import STOPS, KeyButton, LightRow, page
from pipelines.panel.pages.tree_view import TreeView
from pipelines.panel.run_watch import RunState
from pipelines.panel.sentences import Voice
from pipelines.panel.table import table_svg
from storage.artifacts import DOUBTFUL, LATEST, PRODUCTION, Artifact
from storage.errors import StorageError

REFRESH_S: Final = 0.1
"""A run tells of its nodes so often [s]."""
PREFERRED: Final = (PRODUCTION, LATEST, DOUBTFUL)
"""The aliases of a task, the one that is run first."""


class RunPage:
    """One open page. Stop is no matter of it alone: its button and the space bar ask the server at once (keys.js)."""

    def __init__(self, desk: Desk, voice: Voice) -> None:
        self._desk, self._voice = desk, voice
        self._view: TreeView | None = None
        self._shown = self._run_name = ""
        ui.add_head_html(STOPS)
        with page("run", desk.watch.cell, voice):
            self._lights = LightRow()
            with ui.element("div").classes("tw-column"):
                self._build_buttons()
                self._status = ui.label(voice("not_running")).classes("tw-card tw-verdict").props("role=status")
                self._table = ui.html("", sanitize=False).classes("tw-card tw-table")
            with ui.element("div").classes("tw-column"):
                self._tree = ui.element("div").classes("tw-card")
            stop = KeyButton(voice("stop"), " ", None, "red-9", "tw-stop", voice("space"))
            stop.element.props("data-stop")
        ui.timer(REFRESH_S, self.refresh)

    async def refresh(self) -> None:
        """Show what is known now, where it has changed."""
        sight, state = self._desk.watch.now(), self._desk.runs.now()
        self._table.set_content(table_svg(sight, self._desk.watch.frames))
        self._lights.show(self._desk.lights(sight, self._voice))
        self._status.set_text("\n".join(filter(None, _sentences(state, self._voice))))
        self._status.classes(replace=f"tw-card tw-verdict {_style(state)}")
        self._start_button.element.set_enabled(not state.busy and bool(self._choice.options))
        await self._show_tree(state)

    def _build_buttons(self) -> None:
        voice = self._voice
        names = [f"{row['task']}@{name}" for row in self._desk.rows() for name in PREFERRED if name in row["aliases"]]
        chosen = [name for name in names if name.partition("@")[0] == self._desk.choice.task]
        with ui.element("div").classes("tw-card"):
            self._choice = ui.select(names, value=next(iter([*chosen, *names]), None), label=voice("version"))
            self._choice.props("dense").classes("w-full")
            self._watch = ui.checkbox(voice("keep_watching"))
            with ui.element("div").classes("tw-buttons"):
                self._start_button = KeyButton(voice("start"), "r", self._start, "green-8", "tw-wide")

    async def _start(self) -> None:
        tree = str(self._choice.value)
        self._desk.choice.task = tree.partition("@")[0]
        try:
            await asyncio.to_thread(self._desk.runs.start, tree, bool(self._watch.value))
        except CommandError as error:
            ui.notify(str(error), type="negative", timeout=0, close_button=True)

    async def _show_tree(self, state: RunState) -> None:
        """The tree that runs or ran last, else the one that is chosen; its lines as its nodes tick."""
        name = str(state.told["tree"] if state.told and (state.busy or self._is_chosen(state)) else self._choice.value)
        if name != self._shown:
            self._shown = name
            await self._build_tree(name)
        if self._view is not None:
            self._view.paint(state.nodes if state.told.get("tree") == self._run_name else {})

    def _is_chosen(self, state: RunState) -> bool:
        """Whether the run that was told of last is of the task that is chosen."""
        return str(state.told["tree"]).partition("@")[0] == str(self._choice.value).partition("@")[0]

    async def _build_tree(self, name: str) -> None:
        self._view, self._run_name = None, ""
        self._tree.clear()
        try:
            artifact = await asyncio.to_thread(_loaded, self._desk, name)
        except (StorageError, LearnerError) as error:
            with self._tree:
                ui.label(str(error))
            return
        self._run_name = f"{artifact.task}@{artifact.version}"
        folding = Folding(artifact.tree)
        with self._tree:
            ui.label(self._run_name).classes("tw-title")
            recovery = ui.checkbox(self._voice("show_recovery"))
            view = self._view = TreeView(folding, Told(folding, self._voice))
            recovery.on_value_change(lambda event: view.show_recovery(bool(event.value)))


def _loaded(desk: Desk, name: str) -> Artifact:
    task, _, ref = name.partition("@")
    artifact = desk.store.get(task, int(ref) if ref.isdecimal() else ref)
    artifact.tree.flattened()
    return artifact


def _sentences(state: RunState, voice: Voice) -> Iterator[str]:
    """What there is to say of the run, the most important first."""
    told = state.told
    if state.busy and (not told or told["outcome"]):
        yield voice("starting")
    elif not told:
        yield voice("not_running")
    elif told["outcome"]:
        yield voice(f"outcome_{told['outcome']}", tree=told["tree"])
    else:
        yield f"{voice('running_tree', tree=told['tree'])}; {_doing(told, voice)}"
    if state.sentence or not told:
        yield state.sentence
        return
    yield from (voice("failed", action=action, count=count) for action, count in told["failures"].items())
    if told["reason"] and not told["outcome"]:
        yield voice("last_failure", reason=told["reason"])


def _doing(told: Mapping[str, Any], voice: Voice) -> str:
    """What is under way, or why nothing is."""
    if told["action"]:
        return voice("doing", action=told["action"])
    return voice({"success": "holds", "failure": "nothing_left"}.get(str(told["status"]), "waiting"))


def _style(state: RunState) -> str:
    if state.sentence:
        return "refused"
    outcome = state.told.get("outcome")
    return {"success": "accepted", "stopped": "doubtful", None: ""}.get(outcome, "refused")
