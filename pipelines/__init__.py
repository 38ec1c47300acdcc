"""The composition: Prefect flows, the command line, the simulated cell and the controller."""
