"""Checks that accept or reject an edge."""
