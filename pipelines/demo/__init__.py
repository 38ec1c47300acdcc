"""The demo: a whole line on one machine (`local_cell`), taught and run by itself (`demo`)."""
