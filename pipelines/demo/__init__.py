"""The demo: a whole line on one machine (`line`), taught and run by itself (`demo`)."""
