"""The cell with an arm that obeys physics; the only home of PyBullet.

arm_kinematics -> arm, camera -> physics -> motion -> skills. Calls go from right to left.
"""
