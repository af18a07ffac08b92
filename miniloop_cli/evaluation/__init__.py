"""Errors of a result against a ground truth."""
