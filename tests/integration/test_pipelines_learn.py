"""Learn: from the lake's demonstrations to a published version with its lineage; equal trees make no new version."""

from __future__ import annotations

import json
from pathlib import Path
from typing import cast

import pytest
from support_recordings import object_in_box

from learner.learning import METHODS
from learner.parameters import Parameters
from learner.planning.parameters import PlanningParameters, RecoveryParameters
from learner.proof.parameters import ProofParameters
from pipelines.cli import main
from pipelines.controller.job import from_store
from pipelines.errors import CommandError
from pipelines.home import Home
from pipelines.reference import Reference
from pipelines.steps.ingest import ingest
from pipelines.steps.learn import code_version, learn_task
from storage.artifacts import ArtifactStore
from storage.errors import StorageError
from storage.lake import Lake

SAMPLES = Path(__file__).parents[3] / "shared" / "data" / "contract_samples"
TASK = "object_in_box"


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Home:
    monkeypatch.setenv("TREEWRIGHT_HOME", str(tmp_path / "home"))
    monkeypatch.delenv("PREFECT_API_URL", raising=False)
    return Home.current()


def record(home: Home, *seeds: int, **metadata: str) -> None:
    for seed in seeds:
        object_in_box(seed, **metadata).write(home.recordings / f"{seed}.mcap")
    assert not ingest(home, Lake(home.lake)).quarantined


def ids_in(home: Home) -> set[str]:
    """The demonstrations in the lineage of the latest version."""
    with ArtifactStore(home.store) as store:
        lineage = store.get(TASK, "latest").manifest["lineage"]
    return {origin["demonstration_id"] for origin in lineage["demonstrations"]}


def learn(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, object]:
    capsys.readouterr()
    assert main(["learn", TASK, "--json", *words]) == 0
    document: dict[str, object] = json.loads(capsys.readouterr().out)
    return document


def refusal(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    capsys.readouterr()
    assert main(["learn", *words]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_learning_publishes_a_version_and_moves_latest(home: Home, capsys: pytest.CaptureFixture[str]) -> None:
    record(home, 1, 2, 3)
    document = learn(capsys)
    assert (document["task"], document["version"], document["aliases"]) == (TASK, 1, ["latest"])
    with ArtifactStore(home.store) as store:
        artifact = store.verify(TASK, "latest")
    assert artifact.digest == document["digest"]
    assert (artifact.tree.nodes, artifact.tree.nodes_recovery) == (document["nodes"], document["nodes_recovery"])
    assert artifact.manifest["base_frame"] == "base"
    assert artifact.manifest["end_effector_frame"] == "tool0"
    assert artifact.manifest["objects"] == ["A"]
    assert "box" in artifact.manifest["frames"]


def test_the_manifest_tells_what_the_tree_was_learned_from(home: Home, capsys: pytest.CaptureFixture[str]) -> None:
    record(home, 1, 2, 3)
    learn(capsys)
    with ArtifactStore(home.store) as store:
        manifest = store.get(TASK).manifest
    digests = {o["demonstration_id"]: o["sha256"] for o in manifest["lineage"]["demonstrations"]}
    assert digests == {name: sha256 for sha256, name in Lake(home.lake).known().items()}
    assert manifest["lineage"]["code"] == code_version()
    assert manifest["lineage"]["parameters"]["inference"]["min_samples"] == 3
    assert manifest["metrics"]["demonstrations"] == 3
    assert manifest["scene_known"] is False
    assert any("objects are points" in note for note in manifest["notes"])


def test_the_manifest_tells_the_numbers_as_they_were_used(home: Home) -> None:
    record(home, 1, 2, 3)
    numbers = Parameters(
        planning=PlanningParameters(place_radius_m=0.03, recovery=RecoveryParameters(spots=3)),
        proof=ProofParameters(exhaustive=500_000),
    )
    with ArtifactStore(home.store) as store:
        learn_task(Lake(home.lake), store, TASK, parameters=numbers)
        told = store.get(TASK).manifest["lineage"]["parameters"]
    assert told == json.loads(json.dumps(numbers.to_data()))
    assert (told["planning"]["recovery"]["spots"], told["proof"]["exhaustive"]) == (3, 500_000)


def test_a_signal_is_told_as_a_doubt_of_the_tree(home: Home, capsys: pytest.CaptureFixture[str]) -> None:
    for seed in range(3):
        pick, drop = (take := object_in_box(seed)).presses()
        signal = {"stamp_ns": pick["stamp_ns"] + 10**9, "type": "signal", "signal": "door", "value": True}
        take.with_presses([pick, signal, drop]).write(home.recordings / f"{seed}.mcap")
    assert not ingest(home, Lake(home.lake)).quarantined
    learned = learn(capsys)
    (doubt,) = cast(list[dict[str, object]], learned["doubts"])
    assert (learned["aliases"], learned["doubtful"]) == (["doubtful"], [doubt["sentence"]])
    assert doubt["demonstrations"] == [f"{TASK}-{seed}" for seed in range(3)]
    assert (doubt["object"], doubt["what"]) == (None, "signal")
    assert "sets door to true" in str(doubt["sentence"])
    with ArtifactStore(home.store) as store:
        assert store.get(TASK, "doubtful").manifest["doubts"] == [doubt]


def test_a_doubtful_tree_is_run_by_that_name_or_once_somebody_approves_it(
    home: Home, capsys: pytest.CaptureFixture[str]
) -> None:
    for seed in range(3):
        pick, drop = (take := object_in_box(seed)).presses()
        signal = {"stamp_ns": pick["stamp_ns"] + 10**9, "type": "signal", "signal": "door", "value": True}
        take.with_presses([pick, signal, drop]).write(home.recordings / f"{seed}.mcap")
    ingest(home, Lake(home.lake))
    learn(capsys)
    for refused in (f"{TASK}@1", TASK):
        with pytest.raises((CommandError, StorageError), match="doubtful"):
            from_store(home.root, None, Reference.parse(refused))
    assert from_store(home.root, None, Reference.parse(f"{TASK}@doubtful")).name == f"{TASK}@1"
    assert main(["store", "alias", TASK, "production", "1"]) == 1
    assert "treewright approve" in capsys.readouterr().err
    assert main(["approve", f"{TASK}@doubtful", "--by", "ann", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["version"], document["by"], document["aliases"]) == (1, "ann", ["latest"])
    assert from_store(home.root, None, Reference.parse(TASK)).name == f"{TASK}@1"
    assert learn(capsys)["aliases"] == ["latest"]


def test_another_method_gets_an_alias_of_its_own_name(home: Home, capsys: pytest.CaptureFixture[str]) -> None:
    record(home, 1, 2, 3)
    learn(capsys)
    assert main(["learn", TASK, "--method", "paper", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["aliases"] in (["paper"], ["latest", "paper"])
    with ArtifactStore(home.store) as store:
        assert store.aliases(TASK)["latest"] == 1


def test_learning_again_from_the_same_makes_no_new_version(home: Home, capsys: pytest.CaptureFixture[str]) -> None:
    record(home, 1, 2, 3)
    first, second = learn(capsys), learn(capsys)
    assert (first["version"], first["new"], second["version"], second["new"]) == (1, True, 1, False)
    assert first["digest"] == second["digest"]


def test_another_demonstration_makes_another_version(home: Home, capsys: pytest.CaptureFixture[str]) -> None:
    record(home, 1, 2, 3)
    learn(capsys)
    record(home, 4)
    assert learn(capsys)["version"] == 2
    assert len(ids_in(home)) == 4


def test_an_older_tree_learned_again_becomes_the_latest(home: Home, capsys: pytest.CaptureFixture[str]) -> None:
    record(home, 1, 2, 3)
    learn(capsys)
    record(home, 4)
    learn(capsys)
    Lake(home.lake).exclude("object_in_box-4")
    document = learn(capsys)
    assert (document["version"], document["aliases"], document["new"]) == (1, ["latest"], False)


def test_failed_and_unknown_demonstrations_are_kept_but_not_learned_from(
    home: Home, capsys: pytest.CaptureFixture[str]
) -> None:
    record(home, 1, 2, 3)
    record(home, 4, outcome="failure")
    record(home, 5, outcome="unknown")
    assert len(Lake(home.lake).demonstrations(TASK)) == 5
    learn(capsys)
    assert ids_in(home) == {f"{TASK}-{seed}" for seed in (1, 2, 3)}
    learn(capsys, "--include-unknown")
    assert ids_in(home) == {f"{TASK}-{seed}" for seed in (1, 2, 3, 4, 5)}


def test_excluded_demonstrations_are_left_out_and_the_notes_say_so(
    home: Home, capsys: pytest.CaptureFixture[str]
) -> None:
    record(home, 1, 2, 3, 4)
    Lake(home.lake).exclude(f"{TASK}-2")
    notes = learn(capsys)["notes"]
    assert ids_in(home) == {f"{TASK}-{seed}" for seed in (1, 3, 4)}
    assert isinstance(notes, list)
    assert any(f"{TASK}-2 was left out: it is excluded" in note for note in notes)


def test_demonstrations_with_gaps_are_left_out_unless_told(home: Home, capsys: pytest.CaptureFixture[str]) -> None:
    record(home, 1, 2, 3)
    record(home, 4, gaps='["3 messages lost on /poses near action 0"]')
    learn(capsys)
    assert f"{TASK}-4" not in ids_in(home)
    learn(capsys, "--include-gaps")
    assert f"{TASK}-4" in ids_in(home)


@pytest.mark.parametrize("method", sorted(METHODS))
def test_every_method_learns_the_drop_into_the_box(method: str, home: Home, capsys: pytest.CaptureFixture[str]) -> None:
    record(home, 1, 2, 3)
    document = learn(capsys, "--method", method)
    with ArtifactStore(home.store) as store:
        artifact = store.get(TASK)
    drops = [node for node in artifact.tree.flattened().walk() if node.kind == "Drop"]
    assert {(node.port("object"), node.port("frame")) for node in drops} == {("A", "box")}
    assert document["nodes"] <= 16
    assert artifact.manifest["lineage"]["method"] == method


def test_a_task_without_demonstrations_names_those_that_have_some(
    home: Home, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "the lake is empty" in refusal(capsys, "kitting")
    record(home, 1)
    assert f"there are demonstrations of {TASK}" in refusal(capsys, "kitting")


def test_a_task_with_nothing_but_failures_says_so(home: Home, capsys: pytest.CaptureFixture[str]) -> None:
    record(home, 1, outcome="failure")
    assert "its outcome is failure" in refusal(capsys, TASK)


def test_a_bad_task_name_and_a_bad_method_are_refused(home: Home, capsys: pytest.CaptureFixture[str]) -> None:
    assert "task name '../x' is refused" in refusal(capsys, "../x")
    with pytest.raises(SystemExit) as wrong_usage:
        main(["learn", TASK, "--method", "guess"])
    assert wrong_usage.value.code == 2


@pytest.mark.skipif(not SAMPLES.exists(), reason="the sample recordings are not here")
@pytest.mark.parametrize("task", ["object_in_box", "tower_and_box", "tower_and_box_noisy"])
def test_recordings_by_another_writer_are_learned_from_as_they_are(task: str, home: Home) -> None:
    lake = Lake(home.lake)
    assert not ingest(home, lake, sorted(SAMPLES.glob(f"{task}-*.mcap"))).quarantined
    with ArtifactStore(home.store) as store:
        publication = learn_task(lake, store, task)
        frames = store.get(task).tree.frames()
    assert publication.nodes <= 11 * (1 if task == "object_in_box" else 3) + 1
    assert "box" in frames
