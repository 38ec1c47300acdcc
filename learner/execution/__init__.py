"""What a tick means: the same for the controller, the simulated worlds and the proof.

ticking (our interpreter, the reference), engine (py_trees), perception (conditions from what a cell saw).
"""
