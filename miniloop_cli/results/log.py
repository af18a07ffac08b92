"""log.txt: inputs and assumptions of a run, problems of frames, and the outcome."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import yaml

from miniloop_cli.errors import printable
from miniloop_cli.results.assessment import judge
from miniloop_cli.results.calibration import numbers, one_line
from miniloop_cli.results.columns import ReportData
from miniloop_cli.results.tables import frame_status
from miniloop_cli.results.write import versions
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.registration import Registration


def write_log(run: Registration, data: ReportData, problem: str = "") -> None:
    """Write log.txt beside the other results of the run, from which `data` was read; `problem`: why it failed."""
    with atomic_write(data.results.root / "log.txt") as file:
        file.write("".join(f"{printable(line, 2000)}\n" for line in log_lines(run, data, problem)))


def log_lines(run: Registration, data: ReportData, problem: str = "") -> list[str]:
    """The lines of log.txt."""
    sequence, camera = run.sequence, run.sequence.camera
    verdict = judge(data.columns)
    problems = [
        f"frame {k} ({sequence.frames[k].timestamp_s:.6f}): {frame_status(run, k)[1]}"
        for k in np.flatnonzero(run.poses.component != 0).tolist()
    ]
    return [
        f"{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC; " + ", ".join(f"{k} {v}" for k, v in versions().items()),
        f"recording: {sequence.root} (layout {sequence.layout}, {len(sequence.frames)} frames)",
        f"camera: {camera.source}",
        f"  fx {camera.fx:g}, fy {camera.fy:g}, cx {camera.cx:g}, cy {camera.cy:g}, {camera.width} x {camera.height},"
        f" {camera.depth_scale:g} units a metre, lens {camera.lens}",
        *([f"calibrated: {one_line(numbers(run.calibration))}"] if run.calibration else []),
        *(f"note: {note}" for note in run.notes),
        f"seed: {run.seed}",
        "",
        "settings:",
        *(f"  {line}" for line in yaml.safe_dump(run.settings.model_dump(), sort_keys=False, width=120).splitlines()),
        "",
        "seconds:",
        *(f"  {stage:<12} {seconds:9.3f}" for stage, seconds in run.timings_s.items()),
        "",
        "frames without a pose:" if problems else "every frame has a pose",
        *(f"  {line}" for line in problems),
        "",
        verdict.headline,
        *([f"  {problem}"] if problem else []),
        *(f"  {fact}" for fact in verdict.facts),
        *(f"  try: {advice}" for advice in verdict.advice),
    ]
