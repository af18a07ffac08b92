"""Joint refinement of all poses: bundle adjustment and pose graph."""
