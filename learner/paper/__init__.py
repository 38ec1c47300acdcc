"""The published method, plain, kept beside ours to compare with (paper, section III).

pointworld -> backchaining (the planner), constraints -> method. Calls go from right to left.
"""
