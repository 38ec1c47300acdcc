"""How things lie to one another, and what a tree of vocabulary 2 is answered: one code for cells and simulations.

lying (upon, under, in the way) and spots (free room) -> grasping (which grasp is next) -> knowledge (of
the tree) -> answering. Calls go from right to left.
"""
