"""A minimal solver by itself: four scans in a loop, from seven point matches.

python examples/solve_a_cycle.py
"""

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.solvers.cycle4 import cycle4

rng = np.random.default_rng(0)

# Four cameras: T maps points of each scan into the next one, 1 -> 2 -> 3 -> 4, and closing from 1 to 4.
T = se3.pose(se3.exp_so3(rng.normal(scale=0.3, size=(3, 3))), rng.normal(scale=0.3, size=(3, 3)))
closing = T[2] @ T[1] @ T[0]

# Matches (p in the earlier scan, q in the later): two a chain edge, a single one for the edge that closes the loop.
p = rng.uniform((-1, -1, 1), (1, 1, 3), (sum(cycle4.matches), 3))
edge_of_match = np.repeat(np.arange(len(cycle4.matches)), cycle4.matches)
q = np.array([se3.transform([*T, closing][e], x[None])[0] for e, x in zip(edge_of_match, p, strict=True)])

solutions = cycle4(p, q)  # (s, 3, 4, 4): every set of motions that fits the matches exactly
errors_deg = [se3.rotation_angle_deg(s[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)).max() for s in solutions]
print(f"{len(solutions)} solutions from {cycle4.matches} matches; the best is {min(errors_deg):.1e} deg from the truth")
