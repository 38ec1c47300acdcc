"""The simulated cell on a loopback Zenoh network: what it publishes, offers and refuses."""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import zenoh
from support_physical_cell import Witness, free_port, living_cell, open_loopback, witness
from zenoh.ext import HistoryConfig, declare_advanced_subscriber

from learner.model import Pose
from learner.observation import observe
from learner.simulation.cell.arm_kinematics import pointing_down
from learner.simulation.cell.physics import World
from learner.simulation.scenarios import SCENARIOS
from pipelines.errors import CommandError, UnreachableError
from pipelines.network.question import ask
from pipelines.simulated_cell.cell import Cell
from pipelines.simulated_cell.operator import Behavior, ScriptedOperator

ROOT = "treewright/c1"
HURRIED = Behavior(pause_s=(0.05, 0.15), settle_s=0.6)


@pytest.fixture(scope="module")
def shared_session() -> Iterator[zenoh.Session]:
    with living_cell("object_in_box", seed=3) as session:
        yield session


@pytest.fixture
def session(shared_session: zenoh.Session) -> zenoh.Session:
    """A cell at the same start for every test."""
    ask(shared_session, f"{ROOT}/sim/disturb", {"skill_failure_rate": 0.0})
    ask(shared_session, f"{ROOT}/sim/reset", {"seed": 3})
    return shared_session


def truth(session: zenoh.Session) -> dict[str, Any]:
    return ask(session, f"{ROOT}/sim/truth", {})


def grasp_of(session: zenoh.Session, name: str) -> dict[str, Any]:
    """The ports of a pick of an object in its own frame."""
    pose = Pose.of(*(truth(session)["poses"][name][part] for part in ("position", "orientation")))
    turn = pose.quaternion_xyzw
    hand = pose.inverse() @ pointing_down(*pose.position, 2 * math.atan2(turn[2], turn[3]))
    return {"object": name, "frame": name, "position": hand.position, "orientation": hand.quaternion_xyzw}


def drop_in_box(name: str) -> dict[str, Any]:
    return {"object": name, "frame": "box", "position": [0, 0, 0.09], "orientation": [1, 0, 0, 0]}


def call(session: zenoh.Session, skill: str, ports: dict[str, Any], execution_id: str = "e1") -> dict[str, Any]:
    return ask(session, f"{ROOT}/skills/{skill}", {**ports, "execution_id": execution_id}, timeout_s=60)


def eventually(holds: Callable[[], bool]) -> None:
    for _ in range(400):
        if holds():
            return
        time.sleep(0.05)
    pytest.fail("it never came to be")


def test_skills_pick_a_cube_and_drop_it_in_the_box_by_the_worlds_truth(session: zenoh.Session) -> None:
    with witness(session) as seen:
        eventually(lambda: bool(seen.gripper))
        assert call(session, "Pick", grasp_of(session, "A")) == {"status": "success", "reason": None}
        assert truth(session)["held"] == "A"
        assert call(session, "Drop", drop_in_box("A")) == {"status": "success", "reason": None}
        eventually(lambda: truth(session)["goal_held_s"] > 1.0)

    states = [each["state"] for each in seen.gripper]
    assert [state for state, before in zip(states[1:], states, strict=False) if state != before] == ["closed", "open"]
    assert {each["state"]: round(each["width_m"], 2) for each in seen.gripper} == {"open": 0.07, "closed": 0.05}


def test_the_state_is_published_before_the_skill_answers(session: zenoh.Session) -> None:
    with witness(session) as seen:
        eventually(lambda: bool(seen.gripper))
        call(session, "Pick", grasp_of(session, "A"))
        assert seen.gripper[-1]["state"] == "closed"
        height = seen.poses[-1].transforms[-1].translation.z
        assert height > 0.25


def test_poses_and_gripper_are_as_the_contract_says(session: zenoh.Session) -> None:
    with witness(session) as seen:
        eventually(lambda: len(seen.poses) > 40 and len(seen.gripper) > 2)

    assert seen.encodings == {
        "application/protobuf;foxglove.FrameTransforms",
        "application/json;treewright.GripperState",
    }
    assert set(seen.tracks()) == {"A", "box", "tool0"}
    assert {each.parent_frame_id for message in seen.poses for each in message.transforms} == {"base"}
    assert all(np.all(np.diff(track.stamps_ns) > 0) for track in seen.tracks().values())
    assert abs(seen.tracks()["A"].stamps_ns[-1] - time.time_ns()) < 60e9
    assert np.diff([each["stamp_ns"] for each in seen.gripper]).min() > 0
    true = truth(session)["poses"]["A"]["position"]
    assert seen.tracks()["A"].positions.mean(axis=0) == pytest.approx(true, abs=0.002)
    assert np.all(seen.tracks()["A"].positions.std(axis=0) > 0.0005)


def test_a_latecomer_receives_what_was_published_before(session: zenoh.Session) -> None:
    time.sleep(0.5)
    late: list[int] = []
    asked_ns = time.time_ns()

    def take(sample: zenoh.Sample) -> None:
        late.append(json.loads(sample.payload.to_bytes())["stamp_ns"])

    subscriber = declare_advanced_subscriber(session, f"{ROOT}/gripper", take, history=HistoryConfig())
    eventually(lambda: bool(late))
    subscriber.undeclare()

    assert min(late) < asked_ns


@pytest.mark.parametrize(
    ("skill", "request_", "sentence"),
    [
        ("Pick", "[1]", "the request is not a JSON object"),
        ("Pick", "{", "the request is not JSON"),
        ("Pick", '{"object": "A"}', "frame is missing"),
        ("Pick", '{"object": "A", "frame": "A", "position": [0, 0], "orientation": [1, 0, 0, 0]}', "array of 3 finite"),
        ("Place", '{"object": "A", "frame": "A", "position": [0, 0, NaN], "orientation": [1, 0, 0, 0]}', "array of 3"),
        ("Drop", '{"object": "A", "frame": "A", "position": [0, 0, 0], "orientation": [0, 0, 0, 0]}', "no direction"),
        ("Drop", '{"object": "A", "frame": "A", "position": "0;0;0", "orientation": [1, 0, 0, 0]}', "array of 3"),
        ("Pick", '{"object": "A", "frame": "A", "position": [0, 0, 0], "orientation": [1, 0, 0, 0]}', "execution_id"),
        ("SetGripper", '{"state": "ajar", "execution_id": "e"}', "state is open or closed, not 'ajar'"),
        ("SetGripper", '{"state": ["open"], "execution_id": "e"}', "state is open or closed"),
        ("cancel", "{}", "execution_id is missing"),
    ],
)
def test_a_malformed_request_is_answered_by_an_error_of_one_sentence(
    session: zenoh.Session, skill: str, request_: str, sentence: str
) -> None:
    (reply,) = session.get(f"{ROOT}/skills/{skill}", payload=request_, timeout=20)

    assert reply.err is not None
    assert sentence in json.loads(reply.err.payload.to_string())["error"]


def test_an_object_or_frame_that_the_cell_lacks_is_a_failure_with_its_name(session: zenoh.Session) -> None:
    grasp = grasp_of(session, "A")

    assert call(session, "Pick", {**grasp, "object": "Z"})["reason"] == "no object 'Z' in this cell; it has A, box"
    assert call(session, "Pick", {**grasp, "frame": "Z"})["reason"] == "no frame 'Z' in this cell; it has base, A, box"
    assert call(session, "Pick", grasp)["status"] == "success"


def is_running(session: zenoh.Session, execution_id: str) -> bool:
    """Whether the cell says so when asked to cancel another."""
    reason = ask(session, f"{ROOT}/skills/cancel", {"execution_id": "another"})["reason"]
    return f"{execution_id} is running" in reason


def test_one_skill_at_a_time_and_a_cancelled_one_answers_failure() -> None:
    answers: list[dict[str, Any]] = []
    far = {"object": "A", "frame": "base", "position": [0.4, -0.5, 0.05], "orientation": [0, 1, 0, 0]}
    with living_cell("object_in_box", speed=0.1) as session:
        thread = threading.Thread(target=lambda: answers.append(call(session, "Pick", far, "slow")))
        thread.start()
        eventually(lambda: is_running(session, "slow"))
        second = call(session, "SetGripper", {"state": "closed"}, "second")
        cancelled = ask(session, f"{ROOT}/skills/cancel", {"execution_id": "slow"})
        thread.join(30)
        gripper = truth(session)["gripper"]

    assert second["status"] == "failure"
    assert "busy: Pick slow is running" in second["reason"]
    assert cancelled["status"] == "success"
    assert answers == [{"status": "failure", "reason": "cancelled"}]
    assert gripper == "open"


def test_people_disturb_and_the_truth_tells(session: zenoh.Session) -> None:
    call(session, "Pick", grasp_of(session, "A"))
    taken = ask(session, f"{ROOT}/sim/disturb", {"take_from_gripper": {"position": [0.5, 0.0, 0.025]}})
    assert taken["held"] is None
    assert taken["gripper"] == "closed"
    assert taken["poses"]["A"]["position"] == pytest.approx([0.5, 0.0, 0.025])
    assert "not held" in call(session, "Drop", drop_in_box("A"))["reason"]

    moved = ask(session, f"{ROOT}/sim/disturb", {"object": "box"})
    assert moved["poses"]["box"]["position"] != taken["poses"]["box"]["position"]
    with pytest.raises(CommandError, match="no object 'Z' in this cell"):
        ask(session, f"{ROOT}/sim/disturb", {"object": "Z"})
    with pytest.raises(CommandError, match="nothing is held"):
        ask(session, f"{ROOT}/sim/disturb", {"take_from_gripper": {}})


def test_a_cell_told_to_fail_its_skills_fails_them(session: zenoh.Session) -> None:
    ask(session, f"{ROOT}/sim/disturb", {"skill_failure_rate": 1.0})
    assert "by chance" in call(session, "Pick", grasp_of(session, "A"))["reason"]
    ask(session, f"{ROOT}/sim/disturb", {"skill_failure_rate": 0.0})
    assert call(session, "Pick", grasp_of(session, "A"))["status"] == "success"


def test_the_scene_is_the_one_that_a_recorder_wants(session: zenoh.Session) -> None:
    scene = ask(session, f"{ROOT}/sim/scene", {})

    assert scene["objects"] == ["A", "box"]
    assert scene["base_frame"] == "base"
    assert scene["end_effector_frame"] == "tool0"
    assert scene["scene"]["objects"]["A"] == {"size_m": [0.05, 0.05, 0.05], "symmetry": "cube"}


def test_a_second_cell_of_the_same_name_is_refused(session: zenoh.Session) -> None:
    rng = np.random.default_rng(0)
    with (
        World("object_in_box", rng) as world,
        pytest.raises(CommandError, match="a cell 'c1' is running already: process"),
        Cell(session, "c1", world, rng),
    ):
        pass


def test_nobody_answering_is_an_error_of_one_sentence(session: zenoh.Session) -> None:
    with pytest.raises(UnreachableError, match=r"treewright/c9/sim/truth does not answer"):
        ask(session, "treewright/c9/sim/truth", {}, timeout_s=1.0)


def test_a_cell_that_stops_answers_the_skill_that_runs() -> None:
    stop, rng, port = threading.Event(), np.random.default_rng(3), free_port()
    answers: list[dict[str, Any]] = []
    with (
        open_loopback(port, listen=True) as here,
        open_loopback(port, listen=False) as there,
        World("object_in_box", rng) as world,
        Cell(here, "c1", world, rng, speed=0.01) as cell,
    ):
        living = threading.Thread(target=cell.run, args=(stop,))
        caller = threading.Thread(target=lambda: answers.append(call(there, "SetGripper", {"state": "closed"})))
        living.start()
        caller.start()
        eventually(lambda: is_running(there, "e1"))
        stop.set()
        living.join(30)
        caller.join(30)

    assert answers == [{"status": "failure", "reason": "the cell stops"}]


def demonstrated(scenario: str, seed: int) -> tuple[Witness, dict[str, Any]]:
    with living_cell(scenario, seed=seed) as session, witness(session) as seen:
        operator = ScriptedOperator(session, "c1", SCENARIOS[scenario], np.random.default_rng(seed), HURRIED)
        operator.reset()
        operator.perform()
        return seen, truth(session)


def test_what_the_scripted_operator_shows_is_a_demonstration_of_the_scenario() -> None:
    seen, end = demonstrated("tower_and_box", seed=1)
    demonstration = observe(seen.recording("tower_and_box", ["A", "D", "E", "F", "box"]))

    assert end["goal"]
    assert demonstration.warnings == ()
    assert [action.warnings for action in demonstration.actions] == [()] * 6
    shown = {(action.type, action.object): action for action in demonstration.actions}
    assert set(shown) == {("pick", "D"), ("place", "D"), ("pick", "F"), ("place", "F"), ("pick", "A"), ("drop", "A")}
    rest_of_d, rest_of_a = shown["place", "D"].rest, shown["drop", "A"].rest
    assert rest_of_d is not None
    assert rest_of_a is not None
    assert rest_of_d["E"].position == pytest.approx((0.0, 0.0, 0.05), abs=0.015)
    assert rest_of_a["box"].position == pytest.approx((0.0, 0.0, -0.01), abs=0.05)
    hand = demonstration.actions[0].end_effector.position
    assert math.dist(hand, demonstration.actions[0].objects[demonstration.actions[0].object].position) < 0.015


def test_operators_differ_as_people_do_and_the_same_seed_is_the_same_person() -> None:
    with living_cell("object_in_box", seed=4) as session:
        shown = []
        for seed in (1, 1, 2):
            operator = ScriptedOperator(session, "c1", SCENARIOS["object_in_box"], np.random.default_rng(seed), HURRIED)
            operator.reset()
            shown.append(truth(session)["poses"]["A"]["position"])

    assert shown[0] == pytest.approx(shown[1], abs=1e-3)
    assert math.dist(shown[0], shown[2]) > 0.01
