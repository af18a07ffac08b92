"""miniloop itself: from image files to a trajectory, nothing taken from an earlier run."""

from __future__ import annotations

import tempfile
from pathlib import Path

from benchmarks.side_by_side.clock import arguments, write_poses, write_result


def main() -> None:
    options = arguments(__doc__, config="default", seed=0, max_frames=1_000_000)
    import numpy as np

    from miniloop_cli.datasets import open_sequence
    from miniloop_cli.pipeline import register
    from miniloop_cli.presets import load_settings
    from miniloop_cli.runtime.artifact_store import Store
    from miniloop_cli.runtime.parallel import Workers

    sequence = open_sequence(options.sequence, max_frames=options.max_frames)
    with tempfile.TemporaryDirectory() as empty:
        run = register(sequence, load_settings(options.config), Store(Path(empty)), Workers(), options.seed)
    stamps = np.array([frame.timestamp_s for frame in sequence.frames])
    write_poses(options.out, stamps[run.poses.registered], run.poses.T_world_cam[run.poses.registered])
    edges = int(run.edges.verified.sum())
    stages = {name: {"wall": wall, "cpu": run.cpu_timings_s[name]} for name, wall in run.timings_s.items()}
    write_result(options.out, {"stages": stages, "frames": len(stamps), "edges": edges})


if __name__ == "__main__":
    main()
