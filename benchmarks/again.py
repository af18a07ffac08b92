"""`miniloop register` as it is called: first from nothing, then again with one setting of the averaging changed."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from clock import Clock, arguments, write_result

CHANGED = (None, "rotation_scale_deg=2.5", "rotation_scale_deg=4", "translation_scale_m=0.05")


def main() -> None:
    options = arguments(__doc__)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "MINILOOP_CACHE": str(Path(folder) / "cache")}
        command = [sys.executable, "-m", "miniloop_cli", "register", str(options.sequence), "-q", "-o", f"{folder}/out"]
        for setting in CHANGED:
            clock = Clock()
            with clock.stage("register"):
                more = ["--set", f"averaging.{setting}"] if setting else []
                subprocess.run([*command, *more], env=environment, check=True, stdout=subprocess.DEVNULL)
            rows.append({"changed": setting, **clock.stages["register"]})
    write_result(options.out, {"rows": rows})


if __name__ == "__main__":
    main()
