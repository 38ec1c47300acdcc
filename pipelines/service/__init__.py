"""The service side of a shop floor: processes that are started, watched and ended, and what they serve.

child -> prefect_server, keeper -> serve. Calls go from right to left.
"""
