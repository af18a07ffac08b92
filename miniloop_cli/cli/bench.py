"""`miniloop bench NAME`: the paper's experiments and the speed tables, one module a name."""

from __future__ import annotations

import click

from miniloop_cli.cli.main import CONTEXT, LazyGroup

BENCHES: dict[str, str] = {
    "ablation": "miniloop_cli.cli.bench_ablation:bench_ablation",
    "averaging": "miniloop_cli.cli.bench_averaging:bench_averaging",
    "calibration": "miniloop_cli.cli.bench_calibration:bench_calibration",
    "edges": "miniloop_cli.cli.bench_edges:bench_edges",
    "minisequences": "miniloop_cli.cli.bench_minisequences:bench_minisequences",
    "noise": "miniloop_cli.cli.bench_noise:bench_noise",
    "outliers": "miniloop_cli.cli.bench_outliers:bench_outliers",
    "recall": "miniloop_cli.cli.bench_recall:bench_recall",
    "scenes": "miniloop_cli.cli.bench_scenes:bench_scenes",
    "solvers": "miniloop_cli.cli.bench_solvers:bench_solvers",
    "tables": "miniloop_cli.cli.bench_tables:bench_tables",
    "weakloops": "miniloop_cli.cli.bench_weakloops:bench_weakloops",
}


@click.group(cls=LazyGroup, lazy=BENCHES, context_settings=CONTEXT, short_help="Experiments and measurements.")
def bench() -> None:
    """Experiments and measurements; each writes rows (CSV, JSON) and a picture.

    \b
    Example:   miniloop bench solvers --json -
    """
