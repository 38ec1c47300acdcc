"""The tree from what was understood (paper, section III-C).

symmetry, grasps, rounding -> actions (what the robot executes) -> recovery, repairs -> synthesis -> draft.
Calls go from right to left: `draft` makes the tree of an Understanding, once more for each repair.
"""
