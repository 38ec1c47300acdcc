"""The algorithms: from demonstrated actions to a proven behavior tree. No I/O."""
