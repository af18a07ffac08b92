"""The paper's experiments in `miniloop bench`."""

from __future__ import annotations

from pathlib import Path

import click

from miniloop_cli.cli.bench.factory import Benchmark, Column, numbers, whole

SEQUENCES = click.argument(
    "sequences", nargs=-1, required=True, type=click.Path(exists=True, file_okay=False, path_type=Path)
)
MAX_FRAMES = whole("--max-frames", 3, 100, "Evenly spaced frames of SEQ.")
CONFIG = "Preset or settings file for features and matching"

SOLVERS = Benchmark(
    "solvers",
    "Solutions, success and time of the minimal solvers.",
    """Minimal solvers on exact random cycles: number of solutions, share of true poses found, time a call.

    ransac ms: the joint estimator on one pair or cycle of 200 matches an edge, 40 % of them wrong, 2000 hypotheses.

    \b
    Example:   miniloop bench solvers --problems 10000
    """,
    rows="miniloop_cli.bench.solvers:solver_rows",
    draw="miniloop_cli.bench.solvers:draw_histograms",
    columns=numbers(
        ">14",
        ".4g",
        "solver",
        "matches",
        solutions_bound="max",
        paper_max_solutions="paper",
        max_solutions="seen",
        truth_found_share="truth found",
        max_residual="residual",
        us_per_call_batch="us batch",
        us_per_call_single="us single",
        paper_us="us paper",
        ransac_ms="ransac ms",
    ),
    options=(whole("--problems", 1, 100_000, "Problems a solver."),),
    parallel=False,
)

NOISE = Benchmark(
    "noise",
    "Pairs and cycles against noise and wrong matches.",
    """Five cameras, pairwise and by 3-, 4- and 5-cycles: error of camera 5 seen from camera 1.

    \b
    Variants:  paper: best of 1000 hypotheses by inlier count, Procrustes on its inliers
               refined: graded scores, joint refinement on all inliers of the cycle
    Example:   miniloop bench noise --trials 50
    """,
    rows="miniloop_cli.bench.noise:noise_rows",
    draw="miniloop_cli.bench.noise:draw_noise",
    columns=numbers(
        ">11",
        ".4g",
        "sweep",
        "noise",
        "outliers",
        "method",
        "variant",
        "failed",
        rot_deg_median="rot_deg",
        trans_median="trans",
        inliers_percent_mean="inliers",
    ),
    options=(whole("--trials", 1, 200, "Scenes a level; paper: 1000."),),
)

MINISEQUENCES = Benchmark(
    "minisequences",
    "Pairs and cycles on loops of five scans.",
    """Error of scan 5 seen from scan 1, by pairs and by 3-, 4- and 5-cycles, beside the paper's numbers.

    SEQ: recordings with ground truth. Better and equal: shares of the loops, against pairwise.

    \b
    Variants:  paper: best of 2000 hypotheses by inliers within 10 cm, Procrustes on the inliers
               refined: graded scores, joint refinement on all inliers of the cycle
    Example:   miniloop bench minisequences path/to/freiburg1_xyz --config default
    """,
    rows="miniloop_cli.bench.minisequences:minisequence_rows",
    draw="miniloop_cli.bench.minisequences:draw",
    heading="{sequence}, {loops} loops, T = {min_matches}, --config {config}, {variant} (paper's in brackets)",
    columns=(
        Column("", "{method}", "<11"),
        Column("deg", "{rot_deg_mean:.2f} ({paper_rot_deg_mean:.2f})", ">14"),
        Column("cm", "{trans_cm_mean:.2f} ({paper_trans_cm_mean:.2f})", ">14"),
        Column("better deg", "{rot_better:.0%} ({paper_rot_better:.0%})", ">14"),
        Column("better cm", "{trans_better:.0%} ({paper_trans_better:.0%})", ">14"),
        Column("equal deg", "{rot_equal:.0%} ({paper_rot_equal:.0%})", ">14"),
        Column("equal cm", "{trans_equal:.0%} ({paper_trans_equal:.0%})", ">14"),
    ),
    options=(
        SEQUENCES,
        whole("--loops", 1, 200, "Loops of five a recording."),
        click.option(
            "--min-matches",
            type=click.IntRange(min=3),
            metavar="N",
            help="Smallest number of matches of an edge [default: keeps the paper's share of pairs].",
        ),
        click.option(
            "--config",
            "configs",
            multiple=True,
            default=("paper",),
            show_default=True,
            help=f"{CONFIG} (paper: SURF); may be repeated.",
        ),
    ),
)

TABLES = Benchmark(
    "tables",
    "The paper's tables: cycles and final errors.",
    """Cycles of the overlap graph at several T, and errors of the final poses over its edges.

    SEQ: recordings with ground truth. The paper does not give its T. Errors are therefore measured over the graph with
    the paper's number of edges; for other recordings, with the share of pairs of the paper's middle sequence. All
    edges of this graph count, also those that a run did not use.

    \b
    Example:   miniloop bench tables path/to/freiburg1_xyz
    """,
    rows="miniloop_cli.bench.tables:table_rows",
    draw="miniloop_cli.bench.tables:draw",
    heading="{sequence}, --config {config} (paper's in brackets)",
    columns=(
        Column("T", "{min_matches}", ">6"),
        Column("edges", "{edges}", ">8"),
        # Of the table of cycles:
        Column("  decomposition", "  {decomposition}", "<17"),
        *(Column(name, f"{{{name}}} ({{paper_{name}}})", ">12") for name in ("pairwise", "cycle3", "cycle4", "cycle5")),
        # Of the table of errors:
        Column("  mean errors", "  {run}", "<27"),
        Column("registered", "{registered} of {frames}", ">12"),
        Column("scored", "{edges_scored}", ">8"),
        Column("deg", "{rot_deg_mean:.2f} ({paper_rot_deg_mean:.2f})", ">14"),
        Column("cm", "{trans_cm_mean:.2f} ({paper_trans_cm_mean:.2f})", ">14"),
        Column("estimates deg", "{estimate_rot_deg_mean:.2f}", ">15"),
        Column("estimates cm", "{estimate_trans_cm_mean:.2f}", ">14"),
    ),
    options=(
        SEQUENCES,
        click.option("--config", default="paper", show_default=True, help=f"{CONFIG} for the graph (paper: SURF)."),
    ),
)

WEAK_LOOPS = Benchmark(
    "weakloops",
    "Edges with few matches, alone and in cycles.",
    """Share of correct edges (5 deg, 10 cm) among those with 8 to 25 matches, as pairs and in 3- to 7-cycles.

    SEQ: recordings with ground truth. An edge is real, or thinned: a random subset of 40 matches or more. Its partners
    in the cycle are strong (40 matches or more) or as weak as the edge. Pair and cycle get the same matches, the same
    number of hypotheses and the same refinement. An edge is counted if it has at least 5 true matches and lies on
    cycles of all lengths.

    \b
    Example:   miniloop bench weakloops path/to/freiburg1_desk --edges 100
    """,
    rows="miniloop_cli.bench.weakloops:weak_loop_rows",
    draw="miniloop_cli.bench.weakloops:draw_weak_loops",
    heading="{sequence}",
    columns=numbers(
        ">10",
        ".3g",
        "weak",
        "partners",
        "matches",
        "solver",
        "edges",
        right_share="right",
        rot_deg_median="deg",
        trans_cm_median="cm",
        cpu_ms="CPU ms",
    ),
    options=(
        SEQUENCES,
        whole("--edges", 1, 300, "Edges of each kind."),
        whole("--hypotheses", 1, 2000, "Hypotheses for a pair or a cycle."),
        MAX_FRAMES,
    ),
)

PAPER = (MINISEQUENCES, NOISE, SOLVERS, TABLES, WEAK_LOOPS)
