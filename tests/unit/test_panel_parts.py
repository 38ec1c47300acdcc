"""What the panel's pages are made of: sentences, lights, the table from above, presses, and who may ask."""

from __future__ import annotations

import asyncio
import re
import string
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import pipelines.panel
from learner.model import ObjectAt, ObjectShape, Pose, Scene
from pipelines.panel.access.guard import HEADERS, Guard
from pipelines.panel.desk import Desk
from pipelines.panel.goals import destinations
from pipelines.panel.lights import lights_of
from pipelines.panel.sentences import LANGUAGES, SENTENCES, Voice
from pipelines.panel.steps import Steps
from pipelines.panel.table import table_svg
from pipelines.panel.watch import Frames, Sight
from storage.artifacts import ArtifactStore

EVIL = "<script>alert('x')</script>\"&"
FRAMES = Frames()
HAND = Pose((0.5, 0.0, 0.2), (1.0, 0.0, 0.0, 0.0))
STATUS = {"state": "recording", "disk_free_bytes": 50 << 30, "lost": {"/poses": 0}}


def fields(text: str) -> set[str]:
    return {name for _, name, _, _ in string.Formatter().parse(text) if name}


def test_every_sentence_is_there_in_every_language_with_the_same_facts() -> None:
    for key, texts in SENTENCES.items():
        assert len(texts) == len(LANGUAGES), key
        assert all(text.strip() for text in texts), key
        assert len({frozenset(fields(text)) for text in texts}) == 1, key


def test_every_sentence_that_a_page_names_is_written() -> None:
    sources = [file.read_text() for file in Path(pipelines.panel.__file__).parent.rglob("*.py")]
    named = {key for text in sources for key in re.findall(r"\bvoice\(\s*\"(\w+)\"", text)}
    assert named
    assert named <= set(SENTENCES)


@pytest.mark.parametrize(
    ("cookie", "header", "language"),
    [
        (None, "", "en"),
        (None, "de-AT,de;q=0.9,en;q=0.8", "de"),
        (None, "fr, de;q=0.5", "de"),
        ("en", "de", "en"),
        ("../x", "fr", "en"),
    ],
)
def test_a_person_is_spoken_to_in_the_language_chosen_or_the_browsers(
    cookie: str | None, header: str, language: str
) -> None:
    assert Voice.wanted(cookie, header).language == language


def test_the_lights_tell_what_a_press_would_be_refused_for() -> None:
    ages = {"tool0": 0.1, "A": 0.1, "B": 2.0, "C": 7.0}
    poses = dict.fromkeys(ages, HAND)
    sight = Sight(poses=poses, ages_s=ages, gripper="open", gripper_age_s=0.2, status=STATUS)
    colors = {light.name: light.color for light in lights_of(sight, FRAMES, Voice("en"))}
    assert [colors[name] for name in ("tool0", "A", "B", "C")] == ["green", "green", "yellow", "red"]
    assert [colors[name] for name in ("Recorder", "Gripper", "Disk", "Losses")] == ["green"] * 4


def test_silence_and_losses_are_red_lights() -> None:
    sight = Sight(status={**STATUS, "lost": {"/poses": 3, "/x": None}, "disk_free_bytes": 1})
    lights = {light.name: light for light in lights_of(sight, FRAMES, Voice("en"))}
    assert {lights[name].color for name in ("Gripper", "Disk", "Losses", "tool0")} == {"red"}
    assert "3" in lights["Losses"].text
    assert lights_of(Sight(), FRAMES, Voice("de"))[0].color == "red"


def test_a_store_that_fails_is_a_red_light_and_keeps_nobody_from_teaching(tmp_path: Path) -> None:
    (tmp_path / "store.sqlite").write_bytes(b"no database at all" * 100)
    watch: Any = SimpleNamespace(frames=FRAMES)
    nothing: Any = None
    with ArtifactStore(tmp_path) as store:
        desk = Desk(watch, nothing, nothing, store)
        assert desk.tasks() == []
        assert desk.destinations(Sight()) == ()
        first = desk.lights(Sight(status=STATUS), Voice("en"))[0]
    assert (first.name, first.color) == ("Store", "red")
    assert first.text


def test_the_table_shows_each_object_in_its_size_where_it_lies() -> None:
    scene = Scene({"A": ObjectShape((0.1, 0.05, 0.02))}, ((0.2, 0.8), (-0.4, 0.4)))
    sight = Sight(poses={"A": Pose((0.5, 0.1, 0.0)), "tool0": HAND}, ages_s={"A": 0.0, "tool0": 0.0}, scene=scene)
    svg = ET.fromstring(table_svg(sight, FRAMES))
    (body,) = [rect for rect in svg.iter("{http://www.w3.org/2000/svg}rect") if "data-object" in rect.attrib]
    assert (body.get("width"), body.get("height")) == ("100.0", "50.0")
    assert "translate(500.0 -100.0)" in table_svg(sight, FRAMES)


def test_the_table_writes_any_name_as_text_and_has_a_picture_of_nothing() -> None:
    sight = Sight(poses={EVIL: HAND}, ages_s={EVIL: 9.0})
    svg = ET.fromstring(table_svg(sight, FRAMES))
    assert [text.text for text in svg.iter("{http://www.w3.org/2000/svg}text")] == [EVIL]
    assert list(svg.iter("{http://www.w3.org/2000/svg}script")) == []
    assert ET.fromstring(table_svg(Sight(), FRAMES)).tag.endswith("svg")


def test_destinations_move_with_the_frame_in_which_they_are_known() -> None:
    goals = [ObjectAt("A", frame, (0.1, 0.0, 0.0), 0.02) for frame in ("box", "gone", "box@start", "box+gone")]
    (found,) = destinations(goals, {"box": Pose((1.0, 2.0, 0.0))}, "base")
    assert found.at == pytest.approx((1.1, 2.0, 0.0))


def press(step: int, kind: str, stamp_ns: int, verdict: str = "accepted") -> dict[str, Any]:
    return {"step": step, "type": kind, "object": "A", "stamp_ns": stamp_ns, "verdict": verdict, "reason": None}


def test_a_press_that_is_heard_of_twice_counts_once_and_an_undo_takes_back_the_newest() -> None:
    steps = Steps()
    documents = [press(0, "pick", 1), press(1, "place", 2, "contradicts"), press(1, "undo", 3), press(1, "drop", 4)]
    for document in documents:
        steps.take(document)
        steps.take({**document, "event": "action", "stamp_ns": 99, "action_stamp_ns": document["stamp_ns"]})
    assert [(each.type, each.taken_back) for each in steps.steps] == [("pick", False), ("place", True), ("drop", False)]


def test_what_is_not_recorded_is_no_step() -> None:
    steps = Steps()
    steps.take({"event": "action", "type": "pick", "recorded": False, "stamp_ns": 1})
    assert steps.steps == ()


def answered(headers: dict[str, str], kind: str = "http", path: str = "/") -> list[dict[str, Any]]:
    """What the guard sends for a request with such headers, its application answering 200."""
    sent: list[dict[str, Any]] = []

    async def application(scope: Any, receive: Any, send: Any) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def receive() -> dict[str, Any]:
        return {"type": f"{kind}.connect"}

    async def send(message: Any) -> None:
        sent.append(message)

    given = [(name.encode(), value.encode()) for name, value in headers.items()]
    scope = {"type": kind, "path": path, "headers": given}
    asyncio.run(Guard(application)(scope, receive, send))  # type: ignore[arg-type]
    return sent


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"host": "127.0.0.1:8421"}, 200),
        ({"host": "[::1]:8421", "origin": "http://[::1]:8421"}, 200),
        ({"host": "localhost:8421", "origin": "http://localhost:8421"}, 200),
        ({"host": "localhost:8421", "origin": "http://localhost:9999"}, 403),
        ({"host": "localhost:8421", "origin": "null"}, 403),
        ({"host": "evil.example:8421"}, 403),
        ({"host": "evil.example:8421", "origin": "http://evil.example:8421"}, 403),
        ({"host": "[::1"}, 403),
        ({}, 403),
        ({"host": "localhost", "content-length": str(1 << 30)}, 413),
        ({"host": "localhost", "content-length": "-1"}, 413),
    ],
)
def test_only_pages_of_the_panel_itself_may_ask_it(headers: dict[str, str], status: int) -> None:
    assert answered(headers)[0]["status"] == status


def test_the_store_may_be_read_from_anywhere() -> None:
    assert answered({"host": "evil.example"}, path="/v1/tasks")[0]["status"] == 200
    assert answered({"host": "evil.example"}, path="/v1")[0]["status"] == 403


def test_a_stream_of_another_sites_page_is_closed_before_it_opens() -> None:
    (close,) = answered({"host": "localhost:1", "origin": "http://evil.example"}, "websocket")
    assert (close["type"], close["code"]) == ("websocket.close", 1008)


def test_a_browser_is_told_to_load_nothing_from_elsewhere() -> None:
    headers = {name.decode(): value.decode() for name, value in answered({"host": "localhost"})[0]["headers"]}
    assert headers == HEADERS
    assert "http" not in headers["content-security-policy"]
