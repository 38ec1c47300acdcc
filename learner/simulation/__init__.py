"""Worlds in which trees are tried: a kinematic one, and a physical one with an arm (PyBullet).

gravity -> arena -> kinematic_world; cell (arm, skills, camera) -> physical_world. Calls go from right to left.
"""
