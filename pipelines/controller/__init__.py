"""The cell controller: a published tree, ticked against a cell until its success lasts.

trace, cell_link (the cell's network) -> job (what is settled before a cell moves) -> controller.
Calls go from right to left.
"""
