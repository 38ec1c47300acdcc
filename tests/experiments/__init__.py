"""Experiments: tasks and users as data, judged by the truth of a kinematic world."""
