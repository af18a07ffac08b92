"""`miniloop bench minisequences SEQ...`: pairs and cycles on loops of five real scans, as in the paper."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.bench.output import outcome, write
from miniloop_cli.cli.main import CONTEXT


@click.command(name="minisequences", context_settings=CONTEXT, short_help="Pairs and cycles on loops of five scans.")
@click.argument("sequences", nargs=-1, required=True, type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--loops", type=click.IntRange(min=1), default=200, show_default=True, help="Loops of five a recording.")
@click.option(
    "--min-matches",
    type=click.IntRange(min=3),
    help="Matches an edge needs [default: as leave the paper's share of pairs].",
)
@click.option(
    "--config",
    "configs",
    multiple=True,
    default=("paper",),
    show_default=True,
    help="Preset or file that says what is detected and matched (paper: SURF); may be repeated.",
)
@outcome("minisequences")
@options.jobs
def bench_minisequences(
    sequences: tuple[Path, ...],
    loops: int,
    min_matches: int | None,
    configs: tuple[str, ...],
    output: Path | None,
    json_path: str | None,
    jobs: int,
    seed: int,
    quiet: bool,
) -> None:
    """Error of scan 5 seen from scan 1, by pairs and by 3-, 4- and 5-cycles, beside the paper's numbers.

    SEQ: recordings with ground truth. Better and equal: shares of the loops, against pairwise.

    \b
    Variants:  paper: best of 2000 hypotheses by inliers within 10 cm, Procrustes on the inliers
               refined: graded scores, joint refinement on all inliers of the cycle
    Example:   miniloop bench minisequences path/to/freiburg1_xyz --config default
    """
    from miniloop_cli.bench.minisequences import COLUMNS, draw, minisequence_rows
    from miniloop_cli.presets import load_settings
    from miniloop_cli.runtime.parallel import Workers

    rows = []
    for folder in sequences:
        for config in configs:
            settings = load_settings(config)
            rows += minisequence_rows(folder, settings, config, loops, min_matches, seed, Workers(jobs, quiet))
    if json_path != "-":
        for k, row in enumerate(rows):
            group = (row["sequence"], row["config"], row["variant"])
            if k == 0 or group != tuple(rows[k - 1][key] for key in ("sequence", "config", "variant")):
                counts = f"{row['loops']} loops, T = {row['min_matches']}"
                click.echo(f"\n{group[0]}, {counts}, --config {group[1]}, {group[2]} (paper's in brackets)")
                heads = ("deg", "cm", "better deg", "better cm", "equal deg", "equal cm")
                click.echo(f"{'':<11}" + "".join(f"{head:>14}" for head in heads))
            cells = (
                _text(row[key], row[f"paper_{key}"], share)
                for share, key in zip((0, 0, 1, 1, 1, 1), COLUMNS, strict=True)
            )
            click.echo(f"{row['method']:<11}" + "".join(f"{cell:>14}" for cell in cells))
    write("minisequences", rows, partial(draw, rows), output, json_path, quiet)


def _text(value: float | None, paper: float | None, share: bool) -> str:
    if value is None:
        return "-"
    number = f"{100 * value:.0f} %" if share else f"{value:.2f}"
    return number if paper is None else f"{number} ({100 * paper:.0f} %)" if share else f"{number} ({paper:.2f})"
