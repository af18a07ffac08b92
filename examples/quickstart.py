"""From nothing to measured poses in three calls.

python examples/quickstart.py [FOLDER]    (default: quickstart/)
"""

import sys
from pathlib import Path

from miniloop_cli.api import evaluate, register, simulate

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "quickstart")

recording = simulate(folder / "recording", frames=8, width=320, height=240, path="xyz", overwrite=True)
run = register(recording, folder / "result")
numbers = evaluate(folder / "result", recording).numbers

print(f"{len(run.poses.registered)} of {len(run.scans)} frames registered")
print(f"position error {100 * numbers['ate_rmse_m']:.2f} cm RMSE")
print(f"look at {folder / 'result' / 'report.html'}")
