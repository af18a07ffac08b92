"""What lies in a results folder, and how to use it with numpy alone: the least certain frames and the worst edges.

python examples/read_results.py RESULT    (a folder that `miniloop register` wrote)
"""

import csv
import sys
from pathlib import Path

import numpy as np

folder = Path(sys.argv[1])


def table(name: str) -> list[dict[str, str]]:
    """Rows of a CSV file of the result."""
    with (folder / name).open(newline="") as file:
        return list(csv.DictReader(file))


# Poses: camera to world, one row a registered frame: timestamp tx ty tz qx qy qz qw.
poses = np.loadtxt(folder / "trajectory.txt", ndmin=2)
steps = np.linalg.norm(np.diff(poses[:, 1:4], axis=0), axis=1)
print(f"{len(poses)} poses, a path of {steps.sum():.2f} m")

# Frames: those without a pose say why; the others how sure they are.
frames = table("frames.csv")
for frame in frames:
    if frame["registered"] == "0":
        print(f"frame {frame['index']} has no pose: {frame['reason']}")
known = [frame for frame in frames if frame["sigma_trans_m"]]
for frame in sorted(known, key=lambda frame: -float(frame["sigma_trans_m"]))[:3]:
    sigma_mm = 1000 * float(frame["sigma_trans_m"])
    print(f"frame {frame['index']}: position uncertain by {sigma_mm:.1f} mm (1 sigma)")

# Edges: relative poses T_j_i (scan i into scan j) and how far each is from the final poses.
edges = [edge for edge in table("edges.csv") if edge["verdict"] == "verified" and edge["trans_residual_m"]]
for edge in sorted(edges, key=lambda edge: -float(edge["trans_residual_m"]))[:3]:
    words = f"edge {edge['i']}-{edge['j']} ({edge['solver']}, {edge['inliers']} of {edge['matches']} matches)"
    print(f"{words}: off by {edge['rot_residual_deg']} deg, {100 * float(edge['trans_residual_m']):.2f} cm")
