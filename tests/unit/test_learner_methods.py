"""Every registered method: the sizes of its trees, and that they reach the goal in a world of poses."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from support_demonstrations import ON_TOP, Put, Script, Take, hanoi, hanoi_start, repeated, scattered, scripted
from support_pose_world import PoseWorld, done, run

from learner.errors import NothingLearnedError
from learner.execution.ticking import Status
from learner.learned import Learned
from learner.learning import DEFAULT_METHOD, METHODS, learn
from learner.model import Demonstration, Pose

CUBES = "ABCDEF"


def kitting(order: str) -> list[Put]:
    """Cubes in the six fields of the box."""
    fields = {name: (0.1 * (number % 3 - 1), 0.1 * (number // 3) - 0.05, 0.0) for number, name in enumerate(CUBES)}
    return [Put(name, "box", fields[name]) for name in order]


IN_BOX = [Put("A", "box", (0.02, 0.01, 0.0), "drop", fall_m=0.1)]
TOWER = [Put("B", "A", ON_TOP), Put("C", "B", ON_TOP)]
TASKS: dict[str, list[Put]] = {
    "object in box": IN_BOX,
    "tower of three and object in box": [*TOWER, Put("D", "box", (0.0, 0.0, 0.0), "drop", fall_m=0.1)],
    "kitting of four": kitting("ABCD"),
    "a spot of the table": [Put("A", "base", (0.5, 0.7, 0.025)), Put("B", "A", (0.1, 0.0, 0.0))],
}


def names_of(script: Script) -> list[str]:
    names = {name for item in script if isinstance(item, Put) for name in (item.object, item.frame)} - {"base"}
    return sorted(names | {item.object for item in script if isinstance(item, Take)})


@functools.cache
def learned(method: str, task: str) -> Learned:
    script = TASKS[task]
    return learn(repeated(names_of(script), [script] * 3, seed=5), method=method)


def ordered(k: int, count: int = 3, seed: int = 1) -> list[Demonstration]:
    return repeated([*CUBES[:k], "box"], [kitting(CUBES[:k])] * count, seed)


def unordered(k: int, count: int = 3, seed: int = 1) -> list[Demonstration]:
    """Any two placements come in both orders."""
    rng = np.random.default_rng(seed)
    orders = [CUBES[:k], CUBES[:k][::-1], *("".join(rng.permutation(list(CUBES[:k]))) for _ in range(count - 2))]
    return repeated([*CUBES[:k], "box"], [kitting(order) for order in orders], seed)


def start_of(names: Sequence[str], seed: int) -> dict[str, Pose]:
    return scattered(names, np.random.default_rng([seed, 99]), apart_m=0.17)


def is_done(script: Sequence[Put], world: PoseWorld, within_m: float = 0.03) -> bool:
    """Whether every object lies where the script puts it last, by the truth of the world."""
    last = {item.object: item for item in script}
    flat = {name: 2 if item.type == "drop" else 3 for name, item in last.items()}
    return world.held == "none" and all(
        math.dist(world.position(name, item.frame)[: flat[name]], item.at[: flat[name]]) < within_m
        for name, item in last.items()
    )


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("method", METHODS)
def test_the_tree_of_every_method_reaches_the_goal_from_new_starts(method: str, task: str) -> None:
    tree = learned(method, task).tree
    for seed in range(3):
        world = PoseWorld(start_of(names_of(TASKS[task]), seed))
        assert not is_done(TASKS[task], world)
        assert done(tree, world), world.faults[:3]
        assert is_done(TASKS[task], world)
        assert len(world.log) == 2 * len(TASKS[task])


@pytest.mark.parametrize("method", METHODS)
def test_a_finished_task_is_left_alone(method: str) -> None:
    tree = learned(method, "object in box").tree
    world = PoseWorld(start_of(["A", "box"], 0))
    assert done(tree, world)
    did = len(world.log)
    assert run(tree, world) is Status.SUCCESS
    assert len(world.log) == did


@pytest.mark.parametrize("method", METHODS)
def test_what_is_undone_is_done_again(method: str) -> None:
    tree = learned(method, "object in box").tree
    world = PoseWorld(start_of(["A", "box"], 1))
    assert done(tree, world)
    world.poses["A"] = Pose((0.1, 0.6, 0.025))
    assert done(tree, world)
    assert is_done(IN_BOX, world)
    assert len(world.log) == 4


def test_ours_recovers_at_every_point_at_which_a_free_cube_is_moved() -> None:
    task = "tower of three and object in box"
    tree, script = learned(DEFAULT_METHOD, task).tree, TASKS[task]
    for ticks in range(0, 24, 3):
        world = PoseWorld(start_of(names_of(script), ticks))
        run(tree, world, ticks)
        if world.held != "D":
            world.poses["D"] = Pose((0.0, 0.7, 0.025))
        assert done(tree, world), world.faults
        assert is_done(script, world)


def test_ours_goes_on_when_the_held_cube_is_taken_away() -> None:
    tree, script = learned(DEFAULT_METHOD, "object in box").tree, TASKS["object in box"]
    world = PoseWorld(start_of(["A", "box"], 2))
    run(tree, world, until=lambda world: world.held == "A")
    assert world.held == "A"
    world.held, world.poses["A"] = "none", Pose((0.0, 0.7, 0.025))
    assert done(tree, world)
    assert is_done(script, world)


@pytest.mark.parametrize(("k", "size"), [(1, 16), (2, 29), (4, 61), (6, 101)])
def test_the_papers_tree_of_k_ordered_placements_has_the_published_size(k: int, size: int) -> None:
    found = learn(ordered(k), method="paper")
    assert size == k * k + 10 * k + 5
    assert found.tree.nodes == size
    assert len(found.report["groups"]) == 1


@pytest.mark.parametrize("k", [2, 4, 6])
def test_the_papers_tree_without_order_has_eleven_nodes_a_placement_and_five(k: int) -> None:
    assert learn(unordered(k), method="paper").tree.nodes == 11 * k + 5


@pytest.mark.parametrize("k", [1, 2, 4, 6])
def test_our_tree_has_eleven_nodes_a_placement_and_one(k: int) -> None:
    tree = learn(ordered(k)).tree
    assert tree.nodes == 11 * k + 1
    assert tree.nodes_written <= 5 * k + 10


def test_our_tree_without_order_is_as_small_and_reaches_the_goal() -> None:
    tree = learn(unordered(4)).tree
    assert tree.nodes == 45
    world = PoseWorld(start_of([*"ABCD", "box"], 3))
    assert done(tree, world)
    assert is_done(kitting("ABCD"), world)


def test_more_demonstrations_never_make_our_tree_larger() -> None:
    demonstrations = unordered(3, count=10)
    assert [learn(demonstrations[:count]).tree.nodes for count in (3, 5, 10)] == [34, 34, 34]


def test_hanoi_is_seven_placements_in_their_contexts_and_works() -> None:
    rng = np.random.default_rng(4)
    found = learn([scripted(hanoi_start(rng), hanoi(), f"d{n}", rng=rng) for n in range(3)])
    assert found.tree.nodes == 11 * 7 + 1
    for _ in range(3):
        world = PoseWorld(hanoi_start(rng), solid="DEF")
        assert done(found.tree, world), world.faults
        assert is_done(hanoi(), world)
        assert len(world.log) == 14


@pytest.mark.parametrize("method", METHODS)
def test_the_same_demonstrations_in_any_order_give_the_same_bytes(method: str) -> None:
    demonstrations = unordered(2, count=4)
    first = learn(demonstrations, method=method)
    for order in ([3, 2, 1, 0], [1, 3, 0, 2]):
        again = learn([demonstrations[number] for number in order], method=method)
        assert again.tree.to_json() == first.tree.to_json()
        assert (again.report, again.notes) == (first.report, first.notes)


@pytest.mark.parametrize("method", METHODS)
def test_a_demonstration_that_ends_with_a_pick_ends_with_the_object_in_the_gripper(method: str) -> None:
    names = ["A", "B", "box"]
    tree = learn(repeated(names, [[*IN_BOX, Take("B")]] * 3, seed=3), method=method).tree
    world = PoseWorld(start_of(names, 1))
    assert done(tree, world)
    assert world.held == "B"
    assert math.dist(world.position("A", "box")[:2], IN_BOX[0].at[:2]) < 0.03
    assert world.log[-1] == "Pick B"


@pytest.mark.parametrize("method", METHODS)
def test_one_demonstration_gives_a_tree_that_works_for_its_own_start(method: str) -> None:
    start, script = start_of(["A", "B", "box"], 7), kitting("AB")
    tree = learn([scripted(start, script, rng=np.random.default_rng(0))], method=method).tree
    world = PoseWorld(start)
    assert done(tree, world)
    assert is_done(script, world)


# What nothing can be learned from


@pytest.mark.parametrize("method", METHODS)
def test_no_demonstration_is_refused(method: str) -> None:
    with pytest.raises(NothingLearnedError, match="no demonstration"):
        learn([], method=method)


def test_an_unknown_method_is_refused_and_the_known_ones_are_named() -> None:
    with pytest.raises(NothingLearnedError, match=", ".join(METHODS)):
        learn(ordered(1), method="magic")


@pytest.mark.parametrize("field", ["task", "base_frame", "end_effector_frame"])
def test_demonstrations_of_different_things_are_refused(field: str) -> None:
    first, *others = ordered(1)
    with pytest.raises(NothingLearnedError, match=f"differ in their {field.replace('_', ' ')}"):
        learn([replace(first, **{field: "other"}), *others])


@pytest.mark.parametrize(("task", "tree_id"), [("my-task.v2", "my_task_v2"), ("2cubes", "T2cubes")])
@pytest.mark.parametrize("method", METHODS)
def test_the_tree_is_called_as_the_task_in_letters_that_a_tree_may_have(method: str, task: str, tree_id: str) -> None:
    demonstrations = [replace(demonstration, task=task) for demonstration in ordered(1)]
    assert learn(demonstrations, method=method).tree.main.id == tree_id
