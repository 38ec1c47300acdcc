"""The proof of a tree in the abstract world of its own conditions.

abstract_world -> prover. The prover imports nothing of the planner whose trees it checks.
"""
