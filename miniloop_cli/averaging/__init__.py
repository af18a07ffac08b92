"""Motion averaging: relative poses of edges to one pose for each scan."""
