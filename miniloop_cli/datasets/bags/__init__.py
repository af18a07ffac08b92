"""ROS bags and MCAP files: an index of their messages, which are read on demand."""
