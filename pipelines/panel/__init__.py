"""The page for the person at the robot: what a cell shows, the operator's buttons, what was learned, what runs.

    page      what every page has: sentences, keys, navigation     (sentences, page, keys.js)
    teach     the buttons, their verdicts, lights, the table        (watch, steps, lights, table, teach)
    server    who may ask, and the port                             (guard, server)

Calls go from the server to the pages to the watch. NiceGUI has its only home here.
"""
