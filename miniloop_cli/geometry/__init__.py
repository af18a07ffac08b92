"""Rigid motions and cameras."""
