"""A tree tried before it is published: rehearsed, repaired, proven, replayed with the arm.

stage, goal -> visits, rollouts -> rehearsal -> lessons, arm_replay, users -> trial. Calls go from right to left.
"""
