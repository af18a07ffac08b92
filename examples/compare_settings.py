"""The same recording under several settings, in one table: which features, which presets, which solvers.

python examples/compare_settings.py RECORDING [FOLDER]    (RECORDING with ground truth; default folder: compared/)
"""

import sys
from pathlib import Path

from miniloop_cli.api import evaluate, register
from miniloop_cli.errors import MiniloopError

recording = Path(sys.argv[1])
folder = Path(sys.argv[2] if len(sys.argv) > 2 else "compared")

# Name: preset, and what is changed in it.
CANDIDATES = {
    "default": ("default", []),
    "fast": ("fast", []),
    "orb": ("default", ["features.type=orb"]),
    "pairs only": ("default", ["cycles.longest=2"]),
    "averaging only": ("default", ["refine=none"]),
}

print(f"{'settings':<16}{'frames':>8}{'edges':>8}{'ATE cm':>9}{'deg':>8}{'cm':>8}{'seconds':>9}")
for name, (preset, overrides) in CANDIDATES.items():
    output = folder / name.replace(" ", "-")
    try:
        run = register(recording, output, settings=preset, overrides=overrides)
        numbers = evaluate(output, recording).numbers
    except MiniloopError as error:
        print(f"{name:<16}{error}")
        continue
    edges = numbers["rpe"]["edges"]
    errors = f"{edges['rot_deg_mean']:8.3f}{100 * edges['trans_m_mean']:8.2f}"
    seconds = sum(run.timings_s.values())
    count = f"{len(run.poses.registered):8d}{edges['pairs']:8d}"
    print(f"{name:<16}{count}{100 * numbers['ate_rmse_m']:9.2f}{errors}{seconds:9.1f}")
