"""`miniloop cache`: show or remove the finished work that is kept between runs."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from pathlib import Path

import click

from miniloop_cli.cli.main import CONTEXT

DAY_S = 86400.0
ARTEFACT = re.compile(r"(?:[0-9a-f]{32}){1,2}\.(?:npz|tar)")  # 64 digits; 32 of earlier versions
TEMPORARY = re.compile(rf"\.{ARTEFACT.pattern}\..+\.tmp")  # of a run that was killed while writing


@dataclass(frozen=True)
class KeptFile:
    """One file of the store: its kind (features, matches, edges ...), bytes, and days since it was last used."""

    path: Path
    kind: str
    size: int
    age_days: float


@click.group(context_settings=CONTEXT, short_help="Work kept between runs: show, prune.", invoke_without_command=True)
@click.pass_context
def cache(ctx: click.Context) -> None:
    """Finished work kept between runs (features, matches, edges, refined poses, pictures): show or remove it.

    It is in $MINILOOP_CACHE (default ~/.cache/miniloop). If it is removed, the next run computes it again.

    \b
    Example:   miniloop cache
               miniloop cache prune --older-than 30
    """
    if ctx.invoked_subcommand is None:
        ctx.invoke(show)


@cache.command(context_settings=CONTEXT, short_help="Show its folder and its size.")
def show() -> None:
    """Show the folder of the cache and its content by kind.

    \b
    Example:   miniloop cache show
    """
    from miniloop_cli.runtime.artifact_store import default_folder

    folder = default_folder()
    kept = kept_files(folder)
    click.echo(f"{folder}: {total(kept)}")
    kinds = sorted({file.kind for file in kept})
    width = max(map(len, kinds), default=0)
    for kind in kinds:
        own = [file for file in kept if file.kind == kind]
        oldest = max(file.age_days for file in own)
        click.echo(f"  {kind:<{width}}  {total(own):<24}  least recently used {oldest:.0f} days ago")


@cache.command(context_settings=CONTEXT, short_help="Remove kept work.")
@click.option(
    "--older-than",
    "days",
    type=click.FloatRange(min=0),
    metavar="DAYS",
    help="Remove work that was not used for this many days.",
)
@click.option("--all", "everything", is_flag=True, help="Remove everything.")
def prune(days: float | None, everything: bool) -> None:
    """Remove kept work. Only miniloop's own files are removed, and active runs are not disturbed.

    \b
    Example:   miniloop cache prune --older-than 30
    """
    from miniloop_cli.runtime.artifact_store import default_folder

    if everything == (days is not None):
        raise click.UsageError("give --older-than DAYS or --all")
    removed = [file for file in kept_files(default_folder()) if everything or file.age_days >= (days or 0)]
    for file in removed:
        remove(file.path)
    click.echo(f"removed {total(removed)}")


def kept_files(folder: Path) -> list[KeptFile]:
    """Every file of a store, in order of kind and name, without other files of the folder."""
    found = []
    now = time.time()
    for path in sorted(folder.glob("*/*.npz")) + sorted(folder.glob("*/*.tar")) + sorted(folder.glob("*/.*.tmp")):
        if not (ARTEFACT.fullmatch(path.name) or TEMPORARY.fullmatch(path.name)):
            continue
        try:
            state = path.stat()
        except OSError:  # another run has just replaced or removed it
            continue
        found.append(KeptFile(path, path.parent.name, state.st_size, max(0.0, now - state.st_mtime) / DAY_S))
    return found


def remove(path: Path) -> None:
    """Delete a file, if it still exists, and its folder once it is empty. Raises MiniloopError if that fails."""
    from contextlib import suppress

    from miniloop_cli.errors import MiniloopError

    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise MiniloopError(f"cannot remove {path}: {error.strerror or error}") from error
    with suppress(OSError):
        path.parent.rmdir()


def total(files: list[KeptFile]) -> str:
    """Number and size of files, in words."""
    size = sum(file.size for file in files) / 1e6
    return f"{len(files)} file{'s' * (len(files) != 1)}, {size:.1f} MB"
