"""Axes of other tools against those used here: camera x right, y down, z forward; poses camera to world."""

from __future__ import annotations

import numpy as np

# Camera axes x right, y up, z backward (OpenGL, ARKit, Blender, nerfstudio) to ours, and ours to those: it is its own
# inverse. T_world_cam = T_world_gl @ OPENGL_AXES.
OPENGL_AXES = np.diag([1.0, -1.0, -1.0, 1.0])
