"""What makes an edge believed."""
