"""Evidence: frames against no frame at all, and drops that scatter as far as a drop may."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from support_demonstrations import BASE, TABLE_M, Put, Script, scattered, scripted

from learner.inference.parameters import InferenceParameters
from learner.inference.targets import Target
from learner.inference.understanding import Understanding, understand
from learner.model import Demonstration, ObjectShape, Pose, Scene
from learner.regularities.questions import questions

BIN = ObjectShape((0.25, 0.25, 0.08), "box")
PARAMETERS = InferenceParameters()
Made = Callable[[dict[str, Pose], np.random.Generator], Script]


def shown(names: Sequence[str], made: Made, count: int, seed: int) -> list[Demonstration]:
    """Demonstrations from scattered starts, each of a script that goes by its start."""
    shapes = {name: BIN if name in ("bin", "mat") else ObjectShape((0.05, 0.05, 0.05)) for name in names}
    scene = Scene(shapes, ((0.15, 0.85), (-0.55, 0.55)))
    rng, found = np.random.default_rng(seed), []
    for number in range(count):
        start = scattered(names, rng)
        found.append(scripted(start, made(start, rng), f"d{number:03}", rng=rng, scene=scene))
    return found


def understood(names: Sequence[str], made: Made, count: int, seed: int) -> Understanding:
    return understand(shown(names, made, count, seed), PARAMETERS)


def supported(what: Understanding) -> list[Target]:
    return [target for target in what.targets if target.supported]


def anywhere(_: dict[str, Pose], rng: np.random.Generator) -> Script:
    x, y = rng.uniform([0.2, -0.5], [0.8, 0.5]).tolist()
    return [Put("B", BASE, (x, y, TABLE_M), yaw=float(rng.uniform(-3, 3)))]


def between(start: dict[str, Pose], _: np.random.Generator) -> Script:
    x, y, _ = ((np.array(start["A"].position) + np.array(start["C"].position)) / 2).tolist()
    return [Put("B", BASE, (x, y, TABLE_M))]


def dropped(sigma_m: float) -> Made:
    def made(_: dict[str, Pose], rng: np.random.Generator) -> Script:
        x, y = rng.normal(0.0, sigma_m, 2).tolist()
        return [Put("B", "bin", (x, y, 0.02), "drop", 0.08)]

    return made


def test_a_place_between_two_objects_is_told_by_both() -> None:
    for count in (3, 6, 20):
        (target,) = supported(understood("ABC", between, count, seed=4))
        assert (target.frame, target.type) == ("A+C", "place")
        assert target.certainty > 0.99


@pytest.mark.parametrize("made", [anywhere])
def test_more_demonstrations_of_what_no_frame_explains_find_no_frame(made: Made) -> None:
    """Two of a few may lie together by chance; of many, none that count do."""
    few = [supported(understood("ABC", made, count, seed)) for count in (3, 6) for seed in range(10)]
    assert sum(map(bool, few)) <= 2
    for count, seed in ((12, 1), (12, 2), (40, 1), (40, 2)):
        assert not supported(understood("ABC", made, count, seed))


def test_a_frame_is_the_surer_against_none_the_more_demonstrations_there_are() -> None:
    def beside(_: dict[str, Pose], rng: np.random.Generator) -> Script:
        return [Put("B", "A", (0.12, 0.0, 0.0))]

    shares = []
    for count in (3, 6, 12):
        (target,) = supported(understood("AB", beside, count, seed=2))
        assert target.frame == "A"
        shares.append(target.frames["none"])
    assert shares == sorted(shares, reverse=True)
    assert shares[0] < 0.001


@pytest.mark.parametrize("sigma_m", [0.02, 0.04, 0.05])
def test_drops_that_scatter_as_people_scatter_them_belong_to_the_container(sigma_m: float) -> None:
    """Of three such drops no two need lie within the 8 cm of the paper's neighbourhood."""
    for seed in range(12):
        (target,) = understood(["B", "bin", "X"], dropped(sigma_m), 3, seed).targets
        assert (target.type, target.frame, len(target.members)) == ("drop", "bin", 3)


def test_drops_too_scattered_to_be_sure_are_asked_about() -> None:
    for seed in range(40):
        demonstrations = shown(["B", "bin", "X"], dropped(0.06), 3, seed)
        what = understand(demonstrations, PARAMETERS)
        (first, *_) = what.targets
        asked = questions(demonstrations, what.targets, PARAMETERS)
        assert (first.frame == "bin" and first.certainty >= PARAMETERS.sure) or asked


def test_a_question_whose_rival_is_chance_says_so() -> None:
    for seed in range(60):
        demonstrations = shown(["B", "bin", "X"], dropped(0.06), 3, seed)
        asked = questions(demonstrations, understand(demonstrations, PARAMETERS).targets, PARAMETERS)
        if asked and asked[0]["rival"] == "none":
            assert asked[0]["show"] == "move bin to another place"
            assert "or it lies so by chance; " in asked[0]["sentence"]
            return
    pytest.fail("no seed left the evidence open")


def test_what_scatters_widely_in_one_container_is_one_target() -> None:
    several = [len(understood(["B", "bin"], dropped(0.05), 12, seed).targets) for seed in range(12)]
    assert sum(count == 1 for count in several) >= 11


def test_a_wide_spread_alone_does_not_make_a_drop_of_what_was_placed() -> None:
    def upon_a_mat(_: dict[str, Pose], rng: np.random.Generator) -> Script:
        x, y = rng.uniform(-0.06, 0.06, 2).tolist()
        return [Put("B", "mat", (x, y, TABLE_M))]

    for seed in range(6):
        targets = supported(understood(["B", "mat"], upon_a_mat, 8, seed))
        assert {target.type for target in targets} <= {"place"}
