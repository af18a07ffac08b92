"""ROS bags and MCAP files: an index of their messages, and each message read when it is asked for."""
