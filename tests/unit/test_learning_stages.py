"""The stages of learning, as somebody sees them who watches: in order, each with a sentence and a picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar
from xml.etree import ElementTree

import pytest
from support_recordings import object_in_box

from learner.learned import Learned
from learner.learning import learn
from learner.model import Demonstration
from learner.observation import observe
from learner.stages import Stages
from pipelines.steps.cluster_picture import clusters_svg
from pipelines.steps.sentences import sentence_on
from recorder.recording import read_recording

SVG = "{http://www.w3.org/2000/svg}"
Result = TypeVar("Result")


class Watched(Stages):
    """What was seen of the stages."""

    def __init__(self) -> None:
        self.sentences: dict[str, str] = {}
        self.progresses: list[tuple[int, int]] = []

    def run(self, name: str, work: Callable[[], Result]) -> Result:
        result = work()
        self.sentences[name] = sentence_on(result)
        return result

    def progress(self, done: int, most: int) -> None:
        self.progresses.append((done, most))


@pytest.fixture(scope="module")
def demonstrations(tmp_path_factory: pytest.TempPathFactory) -> list[Demonstration]:
    folder = tmp_path_factory.mktemp("recordings")
    files: list[Path] = [object_in_box(seed).write(folder / f"{seed}.mcap") for seed in range(3)]
    return [observe(read_recording([file])) for file in files]


@pytest.fixture(scope="module")
def watched() -> Watched:
    return Watched()


@pytest.fixture(scope="module")
def learned(demonstrations: list[Demonstration], watched: Watched) -> Learned:
    return learn(demonstrations, rehearsed=True, stages=watched)


def test_each_stage_is_seen_in_its_order_with_what_came_out(learned: Learned, watched: Watched) -> None:
    assert list(watched.sentences) == ["cluster", "infer", "plan", "rehearse", "prove", "replay"]
    said = watched.sentences
    assert said["cluster"] == "1 place where something is put: A in the frame box (3 times)"
    assert said["infer"] == "1 group of demonstrations: A at box"
    assert said["plan"].startswith(f"a tree of {learned.tree.nodes} nodes, and {learned.tree.nodes_recovery} that only")
    assert said["rehearse"].startswith("done in ")
    assert said["prove"].startswith("proven from ")
    assert said["replay"] == learned.report["replay"]["reason"]


def test_a_rehearsal_tells_how_far_it_is(learned: Learned, watched: Watched) -> None:
    assert learned
    done, most = watched.progresses[0]
    assert (done, most > 1) == (0, True)


def test_watching_changes_nothing_that_is_learned(learned: Learned, demonstrations: list[Demonstration]) -> None:
    unseen = learn(demonstrations, rehearsed=True)
    assert (unseen.tree, unseen.report, unseen.notes) == (learned.tree, learned.report, learned.notes)


def test_the_published_method_has_its_first_stages_too(demonstrations: list[Demonstration]) -> None:
    watched = Watched()
    learn(demonstrations, method="paper", stages=watched)
    assert watched.sentences == {"cluster": "done", "infer": "done", "plan": "done"}


def test_the_picture_has_a_panel_for_every_candidate_frame_and_marks_the_chosen_one(learned: Learned) -> None:
    assert learned.draft
    picture = clusters_svg(learned.draft.understood)
    root = ElementTree.fromstring(picture)
    texts = [str(text.text) for text in root.iter(f"{SVG}text")]
    assert [text for text in texts if text in ("base", "box")] == ["base", "box"]
    assert any(text.startswith("A: drop in box, spread ") for text in texts)
    chosen = [rect.get("x") for rect in root.iter(f"{SVG}rect") if rect.get("class") == "chosen"]
    frame = next(text for text in root.iter(f"{SVG}text") if text.text == "box")
    assert chosen == [frame.get("x")]
    assert len({circle.get("fill") for circle in root.iter(f"{SVG}circle")}) == 1
    assert len(list(root.iter(f"{SVG}circle"))) == 3 * len([text for text in texts if text in ("base", "box")])
    assert picture == clusters_svg(learned.draft.understood)
