"""Solvers of others on the same problems, each only where it is installed."""
