"""Checks of a recording before a run: its properties, possible problems, and advice."""
