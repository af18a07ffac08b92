"""The nouns: scans, edges, poses, recordings."""
