"""Tracking of points through whole recordings."""
