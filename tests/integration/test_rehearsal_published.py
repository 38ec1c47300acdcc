"""What is published was rehearsed, repaired, proven and replayed with the arm; the manifest tells how that went."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from experiments.demonstrator import demonstrated
from experiments.scenarios import SCENARIOS
from experiments.users import FOURTEEN
from support_demonstrations import Take, repeated
from support_recordings import object_in_box

from learner.learned import Learned
from learner.learning import METHODS, learn
from learner.model import Demonstration, ObjectShape, Scene
from learner.parameters import Parameters
from learner.planning.draft import Draft
from learner.rehearsal.trial import rehearse_and_repair
from pipelines.home import Home
from pipelines.steps.ingest import ingest
from pipelines.steps.learn import Choice, learn_from, publish
from storage.artifacts import ArtifactStore
from storage.errors import AliasRefusedError
from storage.lake import Lake

SCENE = json.dumps(
    {
        "objects": {
            "A": {"size_m": [0.05, 0.05, 0.05], "symmetry": "cube"},
            "box": {"size_m": [0.3, 0.3, 0.08], "symmetry": "box"},
        },
        "workspace_m": [[0.2, 0.9], [-0.6, 0.6]],
    }
)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[ArtifactStore]:
    with ArtifactStore(tmp_path / "store") as opened:
        yield opened


def sorted_(demonstrations: list[Demonstration]) -> list[Demonstration]:
    return sorted(demonstrations, key=lambda demonstration: demonstration.demonstration_id)


def published(store: ArtifactStore, demonstrations: list[Demonstration], learned: Learned) -> dict[str, Any]:
    choice = Choice(demonstrations[0].task, tuple(demonstrations), {}, 1)
    version = publish(store, choice, learned, "treewright").version
    return dict(store.get(choice.task, version).manifest)


def test_the_manifest_tells_of_rehearsal_replay_and_of_each_users_success(store: ArtifactStore) -> None:
    demonstrations = demonstrated(SCENARIOS["tower_and_box"], 3, 5, (FOURTEEN[0], FOURTEEN[6], FOURTEEN[12]), each=True)
    learned = learn_from(Choice("tower_and_box", tuple(demonstrations), {}, 1))
    manifest = published(store, demonstrations, learned)
    report = manifest["report"]
    assert report["rehearsal"]["world"] == "bodies"
    assert report["rehearsal"]["done"] >= 0.9 * report["rehearsal"]["rollouts"] > 20
    assert [run["verdict"] for run in report["replay"]["runs"]] == ["done"] * len(report["replay"]["runs"]) != []
    assert {user["user"]: user["success_without"] for user in report["users"]} == {
        "user01": "3 of 3",
        "user07": "3 of 3",
        "user13": "0 of 3",
    }
    assert manifest["certificate"]["counterexample"] is None
    assert [(doubt["object"], doubt["what"]) for doubt in manifest["doubts"]] == [("E", "place")]
    assert store.aliases("tower_and_box") == {"doubtful": 1}  # two of three users move the tower's base about


def test_learning_again_gives_the_same_bytes() -> None:
    demonstrations = demonstrated(SCENARIOS["object_in_box"], 3, 5)
    once, again = (learn(each, rehearsed=True) for each in (demonstrations, demonstrations[::-1]))
    assert once.tree.to_json() == again.tree.to_json()
    assert json.dumps(once.report) == json.dumps(again.report)
    assert once.notes == again.notes


def test_a_tree_that_fails_every_replay_gets_no_alias_but_doubtful(store: ArtifactStore) -> None:
    """A tree that leaves out the last placement: proven in its own world, wrong in ours."""
    demonstrations = sorted_(demonstrated(SCENARIOS["board"], 3, 5))
    right = METHODS["treewright"](demonstrations, Parameters())
    assert right.draft
    group = right.draft.understood.groups[0]
    shorter = replace(right.draft.understood, groups=(replace(group, subgoals=group.subgoals[:-1]),))
    wrong = Learned(Draft(shorter, Parameters().planning, {}).tree(), {}, (), Parameters())
    learned = rehearse_and_repair(wrong, demonstrations)
    assert learned.report["rehearsal"]["done"] == 0
    assert "false success" in str(learned.certificate)
    assert any(note.startswith("replay: ") for note in learned.notes)
    assert published(store, demonstrations, learned)["certificate"]["counterexample"]
    assert store.aliases("board") == {"doubtful": 1}
    with pytest.raises(AliasRefusedError):
        store.alias("board", "production", 1)


def test_without_a_scene_there_is_no_replay_and_the_manifest_says_so(store: ArtifactStore) -> None:
    demonstrations = [replace(each, scene=None) for each in demonstrated(SCENARIOS["tower_and_box"], 3, 5)]
    report = published(store, demonstrations, learn(demonstrations, rehearsed=True))["report"]
    assert report["replay"]["runs"] == []
    assert report["replay"]["reason"] == "no demonstration tells the shapes of all objects"
    assert report["rehearsal"]["world"] == "points"
    assert report["rehearsal"]["done"] == report["rehearsal"]["rollouts"] > 0


def test_a_task_that_ends_with_something_held_is_rehearsed_and_replayed() -> None:
    cube = ObjectShape((0.05, 0.05, 0.05), "cube")
    demonstrations = repeated(["A", "B"], [[Take("A")]] * 3, scene=Scene({"A": cube, "B": cube}))
    report = learn(demonstrations, rehearsed=True).report
    assert report["rehearsal"]["done"] == report["rehearsal"]["rollouts"] > 10
    assert {run["verdict"] for run in report["replay"]["runs"]} == {"done"}


def test_the_plain_methods_tree_is_judged_too_but_not_repaired() -> None:
    demonstrations = demonstrated(SCENARIOS["object_in_box"], 3, 5)
    report = learn(demonstrations, method="paper", rehearsed=True).report
    assert report["rehearsal"]["repairs"] == []
    assert report["rehearsal"]["rollouts"] > 10
    assert [run["verdict"] for run in report["replay"]["runs"]] == ["done", "done"]


def test_the_command_says_nothing_but_its_json_though_it_loads_the_physics(tmp_path: Path) -> None:
    home = Home(tmp_path / "home")
    for seed in (1, 2, 3):
        object_in_box(seed, scene=SCENE).write(home.recordings / f"{seed}.mcap")
    assert not ingest(home, Lake(home.lake)).quarantined
    environment = {k: v for k, v in os.environ.items() if k != "PREFECT_API_URL"} | {"TREEWRIGHT_HOME": str(home.root)}
    command = [sys.executable, "-m", "pipelines.cli", "learn", "object_in_box", "--json"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["version"] == 1
    assert done.stderr == ""
    with ArtifactStore(home.store) as store:
        report = store.get("object_in_box").manifest["report"]
    assert report["rehearsal"]["done"] == report["rehearsal"]["rollouts"] > 10
    assert report["replay"]["reason"] or report["replay"]["runs"]
