"""Worlds in which trees are tried: a kinematic one, and a physical one with an arm (PyBullet)."""
