"""What lies upon, under and in the way of what, where room is, and what queries of vocabulary 2 find."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import pytest

from learner.model.pose import Pose, Vector
from learner.model.query import (
    CountAt,
    FindGrasp,
    FindHeld,
    FindInTheWay,
    FindObject,
    FindSpot,
    FindUnder,
    FindUpon,
    SignalIs,
    Site,
)
from learner.model.scene import ObjectShape, Scene
from learner.relations.answering import Answering, Seen, Signal
from learner.relations.grasping import MOVED_M, Grasp
from learner.relations.knowledge import Knowledge

CUBE = ObjectShape((0.05, 0.05, 0.05), "cube")
SCENE = Scene(
    {
        **dict.fromkeys("ABC", CUBE),
        "box": ObjectShape((0.2, 0.15, 0.1), open=True),
        "lid": ObjectShape((0.2, 0.15, 0.01)),
        "vise": ObjectShape((0.1, 0.1, 0.06), fixed=True),
        "s1": replace(CUBE, kind="screw"),
        "s2": replace(CUBE, kind="screw"),
    },
    ((0.2, 0.9), (-0.6, 0.6)),
)
HAND = Pose((0.4, 0.0, 0.3), (1.0, 0.0, 0.0, 0.0))


def seen(held: str | None = None, signals: Mapping[str, Signal] | None = None, **places: Vector) -> Seen:
    poses = {name: Pose(place) for name, place in places.items()}
    frames = {"base": Pose((0.0, 0.0, 0.0)), **poses}
    return Seen(poses, HAND, held, frames.get, signals or {})


TOWER = {"A": (0.5, 0.0, 0.025), "B": (0.5, 0.0, 0.075), "C": (0.5, 0.01, 0.125)}


def test_the_topmost_of_what_lies_upon_is_found_and_what_it_lies_upon() -> None:
    asked = Answering(SCENE)
    assert asked.find(FindUpon("A"), seen(**TOWER)) == {"found": "C"}
    assert asked.find(FindUpon("C"), seen(**TOWER)) is None
    assert asked.find(FindUnder("C"), seen(**TOWER)) == {"found": "B"}
    assert asked.find(FindUnder("A"), seen(**TOWER)) is None
    assert asked.find(FindUpon("A"), seen(held="C", **TOWER)) == {"found": "B"}
    assert asked.find(FindUpon("A"), seen(A=TOWER["A"], B=(0.56, 0.0, 0.025))) is None


def test_what_lies_in_an_open_box_does_not_lie_upon_it_but_a_lid_does() -> None:
    asked = Answering(SCENE)
    inside = {"box": (0.5, 0.0, 0.05), "A": (0.5, 0.0, 0.03)}
    assert asked.find(FindUpon("box"), seen(**inside)) is None
    assert asked.find(FindUnder("A"), seen(**inside)) is None
    assert asked.find(FindUpon("box"), seen(**inside, lid=(0.5, 0.0, 0.105))) == {"found": "lid"}
    assert asked.find(FindUnder("A"), seen(vise=(0.5, 0.0, 0.03), A=(0.5, 0.0, 0.085))) is None


def test_what_takes_the_room_to_come_down_is_in_the_way_and_the_topmost_of_it_is_found() -> None:
    asked = Answering(SCENE)
    inside = FindInTheWay("A", "box", (0.0, 0.0, -0.02))
    box = {"box": (0.5, 0.0, 0.05), "A": (0.7, 0.2, 0.025)}
    assert asked.find(inside, seen(**box)) is None
    assert asked.find(inside, seen(**box, lid=(0.5, 0.0, 0.105))) == {"found": "lid"}
    upon = FindInTheWay("A", "B", (0.0, 0.0, 0.05))
    assert asked.find(upon, seen(**TOWER)) is None or asked.find(upon, seen(**TOWER)) == {"found": "C"}
    two = {"A": (0.7, 0.2, 0.025), "B": (0.5, 0.0, 0.025), "C": (0.5, 0.0, 0.075), "s1": (0.5, 0.0, 0.125)}
    assert asked.find(upon, seen(**two)) == {"found": "s1"}
    assert asked.find(upon, seen(held="C", **{**two, "s1": (0.8, 0.3, 0.025)})) is None


@pytest.mark.parametrize("beside_m", [0.051, 0.06])
def test_what_stands_beside_a_place_is_not_in_its_way(beside_m: float) -> None:
    asked = Answering(SCENE)
    place = FindInTheWay("A", "base", (0.5, 0.0, 0.025))
    assert asked.find(place, seen(A=(0.8, 0.0, 0.025), B=(0.5 + beside_m, 0.0, 0.025))) is None
    assert asked.find(place, seen(A=(0.8, 0.0, 0.025), B=(0.52, 0.0, 0.025))) == {"found": "B"}


def test_a_free_spot_is_away_from_things_and_from_every_place_that_the_tree_names() -> None:
    place = Site("base", (0.5, 0.0, 0.025), 0.05)
    asked = Answering(SCENE, Knowledge((), (place,)))
    now = seen(held="A", A=(0.5, 0.0, 0.2), B=(0.5, 0.15, 0.025))
    found = asked.find(FindSpot("A"), now)
    assert found is not None
    x, y, z = found["position"]  # type: ignore[misc]  # three numbers
    left = (x - HAND.position[0] + 0.5, y - HAND.position[1])
    assert math.dist(left, (0.5, 0.0)) > 0.05 + CUBE.size_m[0] / 2
    assert math.dist(left, (0.5, 0.15)) > CUBE.size_m[0]
    assert z == pytest.approx(HAND.position[2] - 0.2 + 0.025 + 0.003)
    assert asked.find(FindSpot("B"), now) is None


def test_an_object_of_a_kind_is_the_one_held_then_one_that_is_free_then_the_nearest() -> None:
    asked = Answering(SCENE)
    bin_ = Site("base", (0.8, 0.4, 0.0), 0.1, rough=True)
    anywhere = FindObject("screw", (), (bin_,))
    lying = {"s1": (0.45, 0.0, 0.025), "s2": (0.6, 0.0, 0.025)}
    assert asked.find(anywhere, seen(**lying)) == {"object": "s1"}
    assert asked.find(anywhere, seen(**lying, A=(0.45, 0.0, 0.075))) == {"object": "s2"}
    assert asked.find(anywhere, seen(held="s2", **lying)) == {"object": "s2"}
    assert asked.find(anywhere, seen(s1=(0.8, 0.42, 0.3))) is None
    assert asked.find(anywhere, seen(held="s1", s1=(0.8, 0.42, 0.3))) == {"object": "s1"}
    at = FindObject("screw", (Site("base", (0.6, 0.0, 0.025), 0.03),), ())
    assert asked.find(at, seen(**lying)) == {"object": "s2"}
    assert asked.find(at, seen(held="s2", **lying)) is None


def test_counting_and_signals() -> None:
    asked = Answering(SCENE)
    sites = (Site("base", (0.5, 0.0, 0.025), 0.03), Site("base", (0.6, 0.0, 0.025), 0.03))
    both = seen(s1=(0.5, 0.0, 0.025), s2=(0.6, 0.0, 0.025))
    assert asked.holds(CountAt("screw", sites, 2), both)
    assert not asked.holds(CountAt("screw", sites, 2), seen(held="s1", s1=(0.5, 0.0, 0.025), s2=(0.6, 0.0, 0.025)))
    assert asked.holds(CountAt("screw", sites, 0), seen())
    told = seen(signals={"door": True, "part": 1})
    assert asked.holds(SignalIs("door", "true"), told)
    assert not asked.holds(SignalIs("part", "true"), told)
    assert not asked.holds(SignalIs("ready", "true"), told)


def test_the_next_grasp_is_tried_after_one_failed_until_the_object_moves() -> None:
    first, second = (Pose((0.0, 0.0, 0.01 * number), (1.0, 0.0, 0.0, 0.0)) for number in (1, 2))
    grasps = (Grasp(second, size_m=CUBE.size_m), Grasp(first, object="A"))
    asked = Answering(SCENE, Knowledge(grasps))
    here, moved = seen(A=(0.5, 0.0, 0.025)), seen(A=(0.5 + 2 * MOVED_M, 0.0, 0.025))
    wanted = {"position": first.position, "orientation": first.quaternion_xyzw}
    assert asked.find(FindGrasp("A"), here) == wanted
    asked.grasping.failed("A", here.poses["A"], first)
    assert asked.find(FindGrasp("A"), here) == {"position": second.position, "orientation": second.quaternion_xyzw}
    asked.grasping.failed("A", here.poses["A"], second)
    assert asked.find(FindGrasp("A"), here) is None
    assert asked.find(FindGrasp("A"), moved) == wanted
    assert asked.find(FindHeld(), here) is None


def test_grasps_are_written_as_the_manifest_has_them() -> None:
    grasp = Grasp(Pose((0.0, 0.0, 0.01), (1.0, 0.0, 0.0, 0.0)), kind="screw")
    data = grasp.to_data()
    assert data == {"kind": "screw", "position": [0.0, 0.0, 0.01], "orientation": [1.0, 0.0, 0.0, 0.0]}
    assert Grasp.of_data(data) == grasp
