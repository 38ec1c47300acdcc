"""The cell with an arm that obeys physics; the only home of PyBullet.

engine, arm_kinematics -> arm, bodies, camera -> rest -> gripper -> gliding, goal -> physics -> motion -> skills. Calls
go from right to left; physics puts the world together, the parts before it each know one thing of it.
"""
