"""The page on which a person sees what was learned: versions, the tree, doubts and questions; and judges it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

from nicegui import ui

from learner.errors import LearnerError
from pipelines.panel.access.tokens import Person
from pipelines.panel.desk import Desk
from pipelines.panel.folding import Folding, Line, Told
from pipelines.panel.pages.frame import PAGES, page
from pipelines.panel.pages.tree_view import TreeView
from pipelines.panel.sentences import Voice
from pipelines.steps.page import sections_of
from storage.artifacts import DOUBTFUL, PRODUCTION, Artifact
from storage.errors import StorageError


class UnderstandPage:
    """One open page on one version of a task."""

    def __init__(
        self, desk: Desk, voice: Voice, person: Person, rows: list[dict[str, Any]], artifact: Artifact | None
    ) -> None:
        self._desk, self._voice, self._person, self._artifact = desk, voice, person, artifact
        report = (artifact.manifest.get("report") or {}) if artifact else {}
        self._shown: list[Mapping[str, Any]] = list(report.get("actions") or ())
        with page("understand", desk.watch.cell, voice):
            with ui.element("div").classes("tw-column"):
                self._build_versions(rows)
                if artifact is not None:
                    if person.may_judge:
                        self._build_judgement(artifact)
                    self._build_sections(artifact)
            if artifact is not None:
                with ui.element("div").classes("tw-column"):
                    self._build_tree(artifact)

    @staticmethod
    async def open(desk: Desk, voice: Voice, person: Person, task: str, version: str) -> UnderstandPage:
        """The page of a version, without a name of the newest of the task, or of the task chosen last."""
        try:
            rows, artifact = await asyncio.to_thread(_loaded, desk, task, version)
        except (StorageError, LearnerError) as error:
            ui.notify(str(error), type="negative", timeout=0, close_button=True)
            rows, artifact = await asyncio.to_thread(_listed, desk), None
        return UnderstandPage(desk, voice, person, rows, artifact)

    def _build_versions(self, rows: list[dict[str, Any]]) -> None:
        with ui.element("div").classes("tw-card"):
            ui.label(self._voice("versions")).classes("tw-title")
            if not rows:
                ui.label(self._voice("nothing_learned"))
            for row in rows:
                for version in row["versions"]:
                    self._build_version(row["task"], version)

    def _build_version(self, task: str, version: Mapping[str, Any]) -> None:
        shown = self._artifact is not None and (self._artifact.task, self._artifact.version) == (
            task,
            version["version"],
        )
        style = "tw-version tw-here" if shown else "tw-version"
        with ui.link(target=f"{PAGES['understand']}?task={task}&version={version['version']}").classes(style):
            ui.label(f"{task} · {self._voice('version_line', version=version['version'])}")
            for name in version["aliases"]:
                ui.label(name).classes("tw-alias tw-doubt" if name == DOUBTFUL else "tw-alias")
            sizes = self._voice("sizes", nodes=version["nodes"], recovery=version["nodes_recovery"])
            made = str(version["created"])[:16].replace("T", " ")
            ui.label(str(version.get("damaged") or f"{made}, {sizes}")).classes("tw-small")

    def _build_judgement(self, artifact: Artifact) -> None:
        voice = self._voice
        with ui.element("div").classes("tw-card tw-judge"):
            known = self._person.name
            self._name = ui.input(voice("user"), value=known or self._desk.choice.user).props("dense").classes("w-full")
            self._name.set_enabled(not known)
            if artifact.standing.doubtful:
                ui.button(voice("approve"), on_click=self._approve, color="orange-9").props("unelevated no-caps")
            elif PRODUCTION not in artifact.aliases:
                ui.button(voice("set_production"), on_click=self._set_production, color="green-8").props(
                    "unelevated no-caps"
                )

    def _build_sections(self, artifact: Artifact) -> None:
        for name, sentences in sections_of(artifact).items():
            if sentences:
                with ui.element("div").classes("tw-card"):
                    ui.label(self._voice(f"section_{name}")).classes("tw-title")
                    for sentence in sentences:
                        ui.label(sentence).classes("tw-sentence")
                    if name in ("questions", "doubtful"):
                        ui.link(self._voice("show_once_more"), f"{PAGES['teach']}?task={artifact.task}")

    def _build_tree(self, artifact: Artifact) -> None:
        folding = Folding(artifact.tree)
        with ui.element("div").classes("tw-card"):
            ui.label(f"{self._voice('tree')}: {artifact.task}@{artifact.version}").classes("tw-title")
            recovery = ui.checkbox(self._voice("show_recovery"))
            view = TreeView(folding, Told(folding, self._voice), self._evidence)
            recovery.on_value_change(lambda event: view.show_recovery(bool(event.value)))

    def _evidence(self, line: Line) -> str:
        """How a place was shown, for the leaf that brings something there."""
        wanted = (line.node.kind.lower(), line.ports.get("object"), line.ports.get("frame"))
        shown = next((each for each in self._shown if (each["type"], each["object"], each["frame"]) == wanted), None)
        if shown is None:
            return ""
        spread, certainty = f"{1000 * shown['spread_m']:.0f}", f"{100 * shown['certainty']:.0f}"
        facts = {"samples": shown["samples"], "frame": shown["frame"]}
        return self._voice("evidence", spread=spread, certainty=certainty, **facts)

    async def _approve(self) -> None:
        name = self._person.name or self._name.value.strip()
        await self._judge(
            lambda store, task, version: store.approve(task, version, name),
            self._voice("approved_now", version=self._version, name=name),
        )

    async def _set_production(self) -> None:
        await self._judge(
            lambda store, task, version: store.alias(task, PRODUCTION, version),
            self._voice("production_now", version=self._version),
        )

    @property
    def _version(self) -> int:
        assert self._artifact is not None  # the buttons stand beside a version
        return self._artifact.version

    async def _judge(self, act: Callable[[Any, str, int], object], done: str) -> None:
        assert self._artifact is not None
        task, version = self._artifact.task, self._artifact.version
        try:
            await asyncio.to_thread(act, self._desk.store, task, version)
        except (StorageError, LearnerError) as error:
            ui.notify(str(error), type="negative", timeout=0, close_button=True)
            return
        self._desk.choice.user = self._desk.choice.user or self._name.value.strip()
        ui.notify(done, type="positive")
        ui.navigate.to(f"{PAGES['understand']}?task={task}&version={version}")


def _listed(desk: Desk) -> list[dict[str, Any]]:
    """All versions of all tasks. Raises StorageError for a store that fails."""
    return [{**row, "versions": desk.store.versions(str(row["task"]))} for row in desk.rows()]


def _loaded(desk: Desk, task: str, version: str) -> tuple[list[dict[str, Any]], Artifact | None]:
    """All versions of all tasks, and the one that is asked for with its tree. Raises StorageError or LearnerError."""
    rows = _listed(desk)
    names = [row["task"] for row in rows]
    chosen = task or (desk.choice.task if desk.choice.task in names else names[0] if names else "")
    if not chosen:
        return rows, None
    newest = next((row["version"] for row in rows if row["task"] == chosen), None)
    asked = int(version) if version.isdecimal() else version or newest
    artifact = desk.store.get(chosen, asked)
    artifact.tree.flattened()
    return rows, artifact
