"""Data types: scans, edges, poses, recordings, maps."""
