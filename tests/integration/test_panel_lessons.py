"""What comes of a demonstration that was kept at the panel: it is taken in, learned from, or told why not."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from support_recordings import object_in_box

from pipelines.home import Home
from pipelines.panel.lessons import Lesson, Lessons


@pytest.fixture
def lessons(tmp_path: Path) -> Iterator[Lessons]:
    with Lessons(Home(tmp_path)) as lessons:
        yield lessons


def ended(lessons: Lessons) -> Lesson:
    deadline_s = time.monotonic() + 60
    while lessons.now.stage in ("reading", "learning"):
        assert time.monotonic() < deadline_s, lessons.now
        time.sleep(0.05)
    return lessons.now


def test_what_is_no_recording_is_refused_with_the_reason(lessons: Lessons, tmp_path: Path) -> None:
    file = tmp_path / "d1.mcap"
    file.write_bytes(b"nothing of the kind")
    lessons.begin("d1", [file])
    lesson = ended(lessons)
    assert (lesson.stage, len(lesson.sentences), lesson.published) == ("refused", 1, None)


def test_a_demonstration_is_understood_although_nothing_can_be_learned_from_it_yet(
    lessons: Lessons, tmp_path: Path
) -> None:
    file = tmp_path / "d1.mcap"
    recording = object_in_box(1, outcome="failure")
    recording.write(file)
    lessons.begin(recording.metadata["demonstration_id"], [file])
    lesson = ended(lessons)
    assert lesson.stage == "failed"
    pick, release = lesson.understood
    assert (pick.type, pick.object) == ("pick", release.object)
    assert release.near
    assert "outcome is failure" in lesson.sentences[-1]
