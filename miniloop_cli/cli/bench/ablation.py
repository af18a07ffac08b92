"""`miniloop bench ablation SEQ...`: what each step is worth on these recordings."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.bench.output import Row, cell, outcome, shown, write
from miniloop_cli.cli.main import CONTEXT

COLUMNS = {
    "registered": "frames",
    "edges": "edges",
    "wrong_share": "wrong",
    "ate_cm": "ATE cm",
    "edge_deg": "edge deg",
    "edge_cm": "edge cm",
    "matching_s": "match s",
    "edges_s": "edges s",
    "averaging_s": "aver. s",
    "refinement_s": "refine s",
    "seconds": "total s",
    "cpu_s": "CPU s",
}


def _show_variants(ctx: click.Context, param: click.Parameter, wanted: bool) -> None:
    if wanted:
        from benchmarks.experiments.ablation import VARIANTS

        for name, variant in VARIANTS.items():
            click.echo(f"{name:<24}{variant.settings}")
        ctx.exit()


@click.command(name="ablation", context_settings=CONTEXT, short_help="What each step is worth on a recording.")
@click.argument("sequences", nargs=-1, required=True, type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--edges",
    "edge_files",
    multiple=True,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Measure edge errors on these (lines 'i j'); one file a SEQ, in order [default: the default's verified].",
)
@click.option("--only", "names", multiple=True, metavar="VARIANT", help="Only this variant beside the default; repeat.")
@click.option(
    "--list",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_show_variants,
    help="Show the variants with their settings, and do nothing else.",
)
@outcome("ablation")
@options.jobs
def bench_ablation(
    sequences: tuple[Path, ...],
    edge_files: tuple[Path, ...],
    names: tuple[str, ...],
    output: Path | None,
    json_path: str | None,
    seed: int,
    jobs: int,
    quiet: bool,
) -> None:
    """One thing changed at a time: frames, errors against ground truth, seconds.

    SEQ: recordings with ground truth. ATE is the rmse after SE(3) alignment on positions; edge errors are means over
    one list of edges that all rows share; wrong is the share of edges whose own estimate, before averaging, is off by
    more than 5 deg or 10 cm; ground truth is the nearest sample within 20 ms. Seconds are those of all
    stages after the features, which come from the cache where they are.

    \b
    Example:   miniloop bench ablation path/to/freiburg1_desk --only "pairwise only" --only "pose graph"
    """
    from benchmarks.experiments.ablation import VARIANTS, ablation_rows, draw
    from miniloop_cli.runtime.parallel import Workers

    def line(row: Row) -> str:
        return f"{row['variant']:<24}" + "".join(f"{cell(row.get(key), '.2f'):>9}" for key in COLUMNS)

    found = ablation_rows(sequences, names or tuple(VARIANTS), edge_files, seed, Workers(jobs, quiet))
    head = " " * 24 + "".join(f"{head:>9}" for head in COLUMNS.values())
    rows = shown(found, head, line, json_path, by="sequence")
    write("ablation", rows, partial(draw, rows), output, json_path, quiet)
