"""`miniloop register` as it is called: first from nothing, then again with one setting of the averaging changed."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.side_by_side.clock import Clock, arguments, write_result

CHANGED = ("rotation_scale_deg=2.5", "rotation_scale_deg=4", "translation_scale_m=0.05")


def main() -> None:
    options = arguments(__doc__)
    clock = Clock()
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "MINILOOP_CACHE": str(Path(folder) / "cache")}
        command = [sys.executable, "-m", "miniloop_cli", "register", str(options.sequence), "-q", "-o", f"{folder}/out"]
        changes: dict[str, list[str]] = {"(from nothing)": []}
        changes |= {setting: ["--set", f"averaging.{setting}"] for setting in CHANGED}
        for name, more in changes.items():
            with clock.stage(name):
                subprocess.run([*command, *more], env=environment, check=True, stdout=subprocess.DEVNULL)
    write_result(options.out, {"stages": clock.stages})


if __name__ == "__main__":
    main()
