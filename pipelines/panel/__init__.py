"""The page for the person at the robot: what a cell shows, the operator's buttons, what was learned, what runs.

    server      the pages on a port                                          ──▶  pages, access
    pages       what is seen and pressed                                     ──▶  desk
    access      who may
    desk        what all pages share: the store, and
                watch, steps, lights, table    the cell as it is now
                lessons                        what comes of a demonstration
                run_watch                      what runs
                folding, goals                 a tree for a person
    sentences   every sentence, in two languages

Calls go down.
"""
