"""Made-up demonstrations: one by hand, and random ones for property tests."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace

from hypothesis import strategies as st

from learner.model import DemonstratedAction, Demonstration, ObjectShape, Pose, Scene

TURNED = (0.0, 0.0, math.sin(0.3), math.cos(0.3))


def demonstration(demonstration_id: str = "d1", task: str = "kitting", content: str = "a") -> Demonstration:
    """A pick of A and a drop of it in the box, with everything that a demonstration can hold."""
    box, cube, gripper = Pose((0.4, 0.1, 0.0), TURNED), Pose((0.3, -0.2, 0.025)), Pose((0.3, -0.2, 0.03), TURNED)
    above = Pose((0.41, 0.09, 0.2), TURNED)
    pick = DemonstratedAction(1, 1_700_000_000_000_000_001, "pick", "A", gripper, {"A": cube, "box": box}, ("box", "A"))
    drop = DemonstratedAction(
        step=2,
        stamp_ns=1_700_000_005_000_000_000,
        type="drop",
        object="A",
        end_effector=above,
        objects={"A": above, "box": box},
        frames=("box",),
        rest={"base": Pose((0.4, 0.1, 0.02)), "box": Pose((0.0, 0.01, 0.02))},
        rest_seen=False,
        warnings=("A was not seen at rest.",),
    )
    return Demonstration(
        demonstration_id=demonstration_id,
        task=task,
        user="u1",
        cell="cell-1",
        base_frame="base",
        end_effector_frame="gripper",
        objects=("A", "box"),
        outcome="success",
        actions=(pick, drop),
        sha256=hashlib.sha256(f"{demonstration_id}{content}".encode()).hexdigest(),
        initial={"A": cube, "box": box},
        final={"A": Pose((0.4, 0.1, 0.02)), "box": box},
        start_ns=1_700_000_000_000_000_000,
        messages_lost={"/poses": 0, "/gripper": None},
        scene=Scene({"A": ObjectShape((0.05, 0.05, 0.05), "cube")}, ((0.0, 1.0), (-0.5, 0.5))),
        warnings=("The box jumped.",),
        gaps=("2 messages were lost on /poses near step 1.",),
    )


NAMES = st.sampled_from(["A", "B", "marker_61", "cube-1.b", "base"])
NUMBERS = st.floats(-5, 5)
POSES = st.builds(
    lambda position, quaternion: Pose.of(
        position, quaternion if any(abs(q) > 0.1 for q in quaternion) else (0, 0, 0, 1)
    ),
    st.tuples(NUMBERS, NUMBERS, NUMBERS),
    st.tuples(*[st.floats(-1, 1)] * 4),
)
POSES_BY_NAME = st.dictionaries(NAMES, POSES, max_size=3)
SENTENCES = st.lists(st.text(max_size=12), max_size=2).map(tuple)
ACTIONS = st.builds(
    DemonstratedAction,
    step=st.just(0),
    stamp_ns=st.integers(0, 2**62),
    type=st.sampled_from(["pick", "place", "drop"]),
    object=NAMES,
    end_effector=POSES,
    objects=POSES_BY_NAME,
    frames=st.lists(NAMES, unique=True, max_size=3).map(tuple),
    rest=st.none() | POSES_BY_NAME,
    rest_seen=st.booleans(),
    warnings=SENTENCES,
)
DEMONSTRATIONS = st.builds(
    Demonstration,
    demonstration_id=st.sampled_from(["d1", "d2", "d3"]),
    task=st.sampled_from(["t1", "t2"]),
    user=NAMES,
    cell=NAMES,
    base_frame=st.just("base"),
    end_effector_frame=NAMES,
    objects=st.lists(NAMES, max_size=3).map(tuple),
    outcome=st.sampled_from(["success", "failure", "unknown"]),
    actions=st.lists(ACTIONS, max_size=3).map(
        lambda actions: tuple(replace(action, step=step) for step, action in enumerate(actions))
    ),
    sha256=st.just("0" * 64),
    initial=POSES_BY_NAME,
    final=POSES_BY_NAME,
    start_ns=st.none() | st.integers(0, 2**62),
    messages_lost=st.none() | st.dictionaries(NAMES, st.none() | st.integers(0, 9), max_size=2),
    scene=st.none()
    | st.builds(
        Scene,
        st.dictionaries(NAMES, st.builds(ObjectShape, st.tuples(NUMBERS, NUMBERS, NUMBERS)), max_size=2),
        st.none() | st.just(((0.0, 1.0), (-0.5, 0.5))),
    ),
    warnings=SENTENCES,
    gaps=SENTENCES,
)
