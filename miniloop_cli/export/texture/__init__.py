"""A texture for a mesh from the sharpest images."""
