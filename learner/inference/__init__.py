"""What was meant: from demonstrated actions to targets, their frames, and goals (paper, sections III-D and III-E).

samples -> moves -> clustering, frames, labels -> targets -> order, goals -> understanding -> users, questions.
Calls go from right to left; nothing here knows of trees.
"""
