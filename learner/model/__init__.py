"""The words of the project: Pose, Condition, Action, Demonstration, Tree. numpy and stdlib only."""

from learner.model.action import Action, Drop, Motion, Pick, Place, SetGripper
from learner.model.condition import Condition, GripperIs, InGripper, ObjectAt, ObjectRoughlyAt, compatible
from learner.model.demonstration import DemonstratedAction, Demonstration
from learner.model.names import check_alias, check_name
from learner.model.pose import Pose
from learner.model.recording import ActionPress, GripperSample, Recording, Track
from learner.model.scene import ObjectShape, Scene
from learner.model.tree import Definition, Node, Tree

__all__ = [
    "Action",
    "ActionPress",
    "Condition",
    "Definition",
    "DemonstratedAction",
    "Demonstration",
    "Drop",
    "GripperIs",
    "GripperSample",
    "InGripper",
    "Motion",
    "Node",
    "ObjectAt",
    "ObjectRoughlyAt",
    "ObjectShape",
    "Pick",
    "Place",
    "Pose",
    "Recording",
    "Scene",
    "SetGripper",
    "Track",
    "Tree",
    "check_alias",
    "check_name",
    "compatible",
]
