"""The composition: Prefect flows, the command line, the simulated cell and the controller.

commands   one file a command              flows        Prefect, its only home     steps    what both call
controller a tree runs on a cell           service      the shop floor's servers   network  Zenoh sessions
demo       the whole line on one machine   simulated_cell
"""
