"""The page on which a person shows a task: large buttons, the verdict of each press, lights, the table from above."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

from nicegui import ui

from pipelines.errors import CommandError
from pipelines.panel.access.tokens import Person
from pipelines.panel.desk import Desk
from pipelines.panel.lessons import Lesson
from pipelines.panel.pages.frame import PAGES, REFRESH_S, KeyButton, LightRow, page
from pipelines.panel.sentences import Voice
from pipelines.panel.steps import Step
from pipelines.panel.table import table_svg
from pipelines.panel.watch import Sight

MOVES: Final = {"pick": "p", "place": "l", "drop": "d"}
"""The actions with their keys."""
NEWEST: Final = 12
"""So many steps are shown."""


class TeachPage:
    """One open page. What it knows is the desk's: a page that is loaded again shows the same."""

    def __init__(self, desk: Desk, voice: Voice, person: Person) -> None:
        self._desk, self._voice, self._person = desk, voice, person
        self._steps: tuple[Step, ...] | None = None
        self._lesson: Lesson | None = None
        self._buttons: dict[str, KeyButton] = {}
        with page("teach", desk.watch.cell, voice):
            self._lights = LightRow()
            with ui.element("div").classes("tw-column"):
                self._build_choice()
                self._build_buttons()
                self._verdict = ui.label(voice("ready")).classes("tw-card tw-verdict").props("role=status")
            with ui.element("div").classes("tw-column"):
                self._table = ui.html("", sanitize=False).classes("tw-card tw-table")
                self._step_list = ui.element("div").classes("tw-card")
                self._lesson_card = ui.element("div").classes("tw-card")
        self._show(self._desk.watch.now())
        ui.timer(REFRESH_S, self.refresh)

    def refresh(self) -> None:
        """Show what is known now, where it has changed, and let those buttons be pressed that make sense."""
        sight = self._desk.watch.now()
        self._show(sight)
        self._enable(sight)

    def _show(self, sight: Sight) -> None:
        self._table.set_content(table_svg(sight, self._desk.watch.frames, self._desk.destinations(sight)))
        self._lights.show(self._desk.lights(sight, self._voice))
        self._show_steps(sight.steps)
        self._show_lesson(self._desk.lessons.now)
        self._offer(sight)

    # --- building

    def _build_choice(self) -> None:
        voice, choice = self._voice, self._desk.choice
        with ui.element("div").classes("tw-card tw-fields"):
            self._task = ui.input(voice("task"), value=choice.task, autocomplete=self._desk.tasks()).props("dense")
            self._user = ui.input(voice("user"), value=self._person.name or choice.user).props("dense")
            self._user.set_enabled(not self._person.name)
            self._objects = ui.select([], label=voice("objects"), multiple=True).props("dense use-chips")
            self._object = ui.select({"": voice("nearest")}, value="", label=voice("object")).props("dense")
            for field in (self._task, self._user, self._objects, self._object):
                field.classes("w-full")

    def _build_buttons(self) -> None:
        with ui.element("div").classes("tw-card tw-buttons"):
            self._add("start", "s", self._start, "green-8", "tw-wide")
            for name, key in MOVES.items():
                self._add(name, key, partial(self._press, name), "blue-8")
            self._add("undo", "u", partial(self._press, "undo"), "orange-9", "tw-half")
            self._add("pause", "h", self._pause, "blue-grey-7", "tw-half")
            self._add("keep", "k", self._keep, "green-8", "tw-half")
            self._add("discard", "x", self._discard, "red-9", "tw-half")

    def _add(self, name: str, key: str, press: Callable[[], Awaitable[None]], color: str, style: str = "") -> None:
        self._buttons[name] = KeyButton(self._voice(name), key, press, color, style)

    # --- showing

    def _show_steps(self, steps: tuple[Step, ...]) -> None:
        if steps == self._steps:
            return
        self._steps = steps
        self._step_list.clear()
        with self._step_list:
            for step in steps[-NEWEST:]:
                style = "taken" if step.taken_back else step.verdict
                ui.label(self._told(step)).classes(f"tw-step {style}")
            if not steps:
                ui.label(self._voice("no_steps"))

    def _show_lesson(self, lesson: Lesson) -> None:
        if lesson == self._lesson:
            return
        self._lesson = lesson
        self._lesson_card.set_visibility(lesson.stage != "none")
        self._lesson_card.clear()
        with self._lesson_card:
            for sentence in _lesson_sentences(lesson, self._voice):
                ui.label(sentence).classes("tw-sentence")
            if lesson.published:
                target = f"{PAGES['understand']}?task={lesson.task}&version={lesson.published['version']}"
                ui.link(self._voice("look_at_it"), target)

    def _told(self, step: Step) -> str:
        voice = self._voice
        name = self._named(step.number, step.type, step.object)
        said = voice("taken_back") if step.taken_back else step.reason or voice(step.verdict)
        return f"{name}: {said}"

    def _named(self, place: int, kind: str, name: str | None) -> str:
        """A step by the number that the recorder's sentences, and all commands, tell it by."""
        return self._voice("step", number=place, type=self._voice(kind), object=name or "").strip()

    def _enable(self, sight: Sight) -> None:
        state = sight.status["state"] if sight.status else None
        for name, each in self._buttons.items():
            fits = {"start": state == "idle", "pause": state in ("recording", "paused")}
            fits |= dict.fromkeys(("keep", "discard"), state in ("recording", "paused"))
            each.element.set_enabled(fits.get(name, state == "recording"))
        self._buttons["pause"].text.set_text(self._voice("resume" if state == "paused" else "pause"))

    def _offer(self, sight: Sight) -> None:
        """Names that came since the page was opened; at first all are chosen."""
        names = list(sight.objects(self._desk.watch.frames))
        if names == self._objects.options:
            return
        new = [name for name in names if name not in self._objects.options]
        self._objects.set_options(names, value=[*(self._objects.value or []), *new])
        self._object.set_options({"": self._voice("nearest"), **{name: name for name in names}})

    # --- buttons

    async def _start(self) -> None:
        watch, scene = self._desk.watch, self._desk.watch.now().scene
        request = {
            "task": self._task.value.strip(),
            "user": self._person.name or self._user.value.strip(),
            "objects": self._objects.value,
            "base_frame": watch.frames.base,
            "end_effector_frame": watch.frames.hand,
            **({"scene": scene.to_data()} if scene else {}),
        }
        if await self._ask("start", request, "begun") is not None:
            self._desk.choice.task, self._desk.choice.user = request["task"], request["user"]

    async def _pause(self) -> None:
        status = self._desk.watch.now().status
        paused = status is not None and status["state"] == "paused"
        await self._ask("resume" if paused else "pause", {}, "resumed" if paused else "paused")

    async def _keep(self) -> None:
        reply = await self._ask("stop", {"outcome": "success"}, "kept")
        if reply is not None:
            files = reply.get("parts") or [reply["file"]]
            self._desk.lessons.begin(reply["demonstration_id"], [Path(file) for file in files])

    async def _discard(self) -> None:
        await self._ask("discard", {}, "thrown_away")

    async def _ask(self, verb: str, request: Mapping[str, Any], done: str) -> dict[str, Any] | None:
        """The recorder's reply, which is told too; None where it refuses."""
        try:
            reply = await asyncio.to_thread(self._desk.watch.button, verb, request)
        except CommandError as error:
            self._say(str(error), "refused")
            return None
        self._say(self._voice(done), "")
        self.refresh()
        return reply

    async def _press(self, kind: str) -> None:
        name = self._object.value if kind != "undo" else ""
        try:
            reply = await asyncio.to_thread(self._desk.watch.press, kind, name or None)
        except CommandError as error:
            self._say(str(error), "refused")
            return
        self._say(self._judged(reply), reply["verdict"])
        self.refresh()

    def _judged(self, reply: Mapping[str, Any]) -> str:
        voice, verdict = self._voice, reply["verdict"]
        if reply["type"] == "undo" and verdict == "accepted":
            return voice("taken_back_now", number=reply["step"])
        name = self._named(reply["step"], reply["type"], reply["object"])
        lines = [f"{name}: {voice(verdict)}", reply["reason"], None if verdict == "accepted" else voice("what_to_do")]
        return "\n".join(line for line in lines if line)

    def _say(self, text: str, style: str) -> None:
        self._verdict.set_text(text)
        self._verdict.classes(replace=f"tw-card tw-verdict {style}")


def _lesson_sentences(lesson: Lesson, voice: Voice) -> Iterator[str]:
    """What was understood of the newest demonstration, and what was learned with it."""
    for each in lesson.understood:
        key = f"understood_{each.type}" + ("_near" if each.near else "")
        yield voice(key, object=each.object, near=each.near, distance=f"{1000 * each.distance_m:.0f}")
    published = lesson.published
    if published:
        yield voice(
            "lesson_learned" if published["new"] else "lesson_same", task=lesson.task, version=published["version"]
        )
        yield from published["doubtful"]
    elif lesson.stage != "none":
        yield voice(f"lesson_{lesson.stage}")
    yield from lesson.sentences
