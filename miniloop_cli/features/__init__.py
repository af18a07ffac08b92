"""Detectors, descriptors, matching, retrieval."""
