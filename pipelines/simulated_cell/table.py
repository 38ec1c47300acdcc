"""The table of a simulated cell as a profile of the cell has it: bodies made of sizes."""

from __future__ import annotations

from typing import Final

from learner.model import Scene
from learner.model.scene import ObjectShape
from learner.simulation.gravity import WALL_M, Body, Kind
from learner.simulation.scenarios import BASE, TOOL, Scenario
from learner.simulation.scenarios import Body as Simulated
from pipelines.errors import CommandError
from pipelines.profile import FRAMES, Profile

DENSITY_KG_PER_M3: Final = 800.0
"""Of everything: that of the scenarios' cubes of 0.1 kg."""


def scenario_of(profile: Profile) -> Scenario:
    """What stands on the table, with nothing to be done and no goal.

    What is `open` has a floor and walls; a block can be grasped unless it is `fixed` or too wide for the fingers.
    Raises CommandError for objects that are called as the frames of the simulated arm are.
    """
    scene = Scene.of_data(profile.scene)
    if taken := {BASE, TOOL} & set(scene.objects):
        raise CommandError(f"no object of a simulated cell is called {min(taken)}: the arm has a frame of this name")
    bodies = {name: _body(shape) for name, shape in scene.objects.items()}
    return Scenario(bodies, (), (), workspace_m=scene.workspace_m)


def profile_of_scenario(scenario: Scenario) -> Profile:
    """What a scenario shows, as the profile that a person would write of it."""
    scene = scenario.scene.to_data()
    for name, body in scenario.bodies.items():
        if body.wall_m is not None:
            scene["objects"][name]["open"] = True
    return Profile(**FRAMES, scene=scene)


def _body(shape: ObjectShape) -> Simulated:
    kind: Kind = "open_box" if shape.open else "block"
    body = Body(shape, kind)
    volume = sum(4 * solid.half_x * solid.half_y * (solid.top - solid.bottom) for solid in body.solids)
    wall_m, graspable = WALL_M if shape.open else None, body.graspable and not shape.fixed
    return Simulated(shape.size_m, DENSITY_KG_PER_M3 * volume, shape.symmetry, wall_m, graspable)
