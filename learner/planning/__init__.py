"""The tree from what was understood (paper, section III-C).

symmetry, grasps, rounding -> actions (what the robot executes) -> obstacles (what may lie in the way) -> relational
(recovery where shapes are known), or spots -> demonstrated (where they are not) -> synthesis -> draft; `recovery` says
what both are to the synthesis, repairs are values that a draft is handed.
Calls go from right to left: `draft` makes the tree of an Understanding, once more for each repair.
"""
