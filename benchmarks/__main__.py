"""`python -m benchmarks NAME`, in the folder of the repository."""

from __future__ import annotations

import click

from benchmarks.table import MEASUREMENTS
from miniloop_cli.cli.bench.factory import command
from miniloop_cli.cli.main import CONTEXT, LazyGroup, main

OTHERS = {
    "color-icp": "benchmarks.color_icp:color_icp",
    "features": "benchmarks.features:features",
    "inspection": "benchmarks.inspection:inspection",
    "run": "benchmarks.run:run",
}


@click.group(
    cls=LazyGroup,
    commands=[command(benchmark) for benchmark in MEASUREMENTS],
    lazy=OTHERS,
    context_settings=CONTEXT,
)
def benchmarks() -> None:
    """What miniloop is measured by beside the paper's experiments (those are `miniloop bench`).

    The first seven write rows (CSV, JSON) and a picture, the next three print; run writes BENCHMARK.md.

    \b
    Example:   python -m benchmarks ablation path/to/freiburg1_desk
    """


if __name__ == "__main__":
    main(command=benchmarks, program="python -m benchmarks")
