"""The algorithms: from demonstrated actions to a proven behavior tree. No input or output.

model        the words                      inference    what was meant         planning    the tree from it
paper        the published method           proof        a tree, proven         execution   what a tick means
simulation   worlds to try a tree in        rehearsal    tried before publishing
regularities what the tree does not reproduce

`learning.learn` is the one call that the pipelines make. Calls go one way: learning, then rehearsal, simulation and
proof, then planning, inference, model (tests/unit/test_arrows.py).
"""
