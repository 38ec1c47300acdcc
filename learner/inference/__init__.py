"""What was meant: from demonstrated actions to targets, their frames, and goals (paper, sections III-D and III-E).

    samples -> moves -> clustering, contexts -> support, labels, frames -> targets -> finding, ties
            -> chains -> goals -> visits -> understanding -> users

Values flow along the arrows and calls go against them; nothing here knows of trees.
"""
