"""What the teacher is told while a demonstration is recorded, so that a step is repeated and not the day.

watch keeps what the cell shows: known which frames there are at all, feedback where each was in the last seconds and
what is wrong with that around an action. presses judges each press by it. Calls go that way back: presses, watch,
feedback and known.
"""
