"""The tree from what was understood (paper, section III-C).

symmetry, grasps, rounding -> actions (what the robot executes) -> obstacles (what may lie in the way) -> covers,
occupations, spots -> recovery -> synthesis -> draft; repairs are values that a draft is handed.
Calls go from right to left: `draft` makes the tree of an Understanding, once more for each repair.
"""
