"""Zenoh as commands and controllers use it: sessions, questions to queryables, publishers."""
