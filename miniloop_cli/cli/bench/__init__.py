"""`miniloop bench NAME`: the paper's experiments and the speed tables, one module a name."""

from __future__ import annotations

import click

from miniloop_cli.cli.main import CONTEXT, LazyGroup

BENCHES: dict[str, str] = {
    "ablation": "miniloop_cli.cli.bench.ablation:bench_ablation",
    "averaging": "miniloop_cli.cli.bench.averaging:bench_averaging",
    "calibration": "miniloop_cli.cli.bench.calibration:bench_calibration",
    "edges": "miniloop_cli.cli.bench.edges:bench_edges",
    "minisequences": "miniloop_cli.cli.bench.minisequences:bench_minisequences",
    "noise": "miniloop_cli.cli.bench.noise:bench_noise",
    "outliers": "miniloop_cli.cli.bench.outliers:bench_outliers",
    "recall": "miniloop_cli.cli.bench.recall:bench_recall",
    "scenes": "miniloop_cli.cli.bench.scenes:bench_scenes",
    "solvers": "miniloop_cli.cli.bench.solvers:bench_solvers",
    "tables": "miniloop_cli.cli.bench.tables:bench_tables",
    "weakloops": "miniloop_cli.cli.bench.weakloops:bench_weakloops",
}


@click.group(cls=LazyGroup, lazy=BENCHES, context_settings=CONTEXT, short_help="Experiments and measurements.")
def bench() -> None:
    """Experiments and measurements; each writes rows (CSV, JSON) and a picture.

    \b
    Example:   miniloop bench solvers --json -
    """
