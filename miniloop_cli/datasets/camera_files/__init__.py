"""Camera files: our own camera.yaml and those of other tools, recognised by their content."""

from miniloop_cli.datasets.camera_files.read import read_camera_file, read_depth_camera

__all__ = ["read_camera_file", "read_depth_camera"]
