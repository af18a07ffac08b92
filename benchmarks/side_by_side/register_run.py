"""`miniloop register` as it is called, report and model included, from image files to results, nothing kept."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.side_by_side.clock import arguments


def main() -> None:
    options = arguments(__doc__, seed=0)
    with tempfile.TemporaryDirectory(dir=options.out.parent) as folder:
        environment = {**os.environ, "MINILOOP_CACHE": str(Path(folder) / "cache")}
        command = [sys.executable, "-m", "miniloop_cli", "register", str(options.sequence), "-q"]
        command += ["-o", f"{folder}/out", "--seed", str(options.seed)]
        done = subprocess.run(command, env=environment, check=False)
        if done.returncode:
            sys.exit(done.returncode)
        for name in ("trajectory.txt", "edges.csv", "frames.csv"):
            suffix = ".txt" if name == "trajectory.txt" else f".{name}"
            shutil.copyfile(Path(folder) / "out" / name, options.out.with_suffix(suffix))


if __name__ == "__main__":
    main()
