"""Joining recordings to a map, and locating images in it."""
