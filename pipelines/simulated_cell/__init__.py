"""The cell that stands in for a real one, and its scripted operator.

cell answers requests (their fields are checked in fields) and shows itself (showing); operator knows it by the network
alone.
"""
