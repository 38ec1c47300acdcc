"""The simulated cell on Zenoh: what `treewright sim` is, and an operator made of a script that teaches it."""
