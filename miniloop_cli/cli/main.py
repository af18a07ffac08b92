"""The launcher: finds the command, runs it, reports every known error in one line with exit status 1.

Commands are imported only when they run, so `--help` and completion are fast.
"""

from __future__ import annotations

import difflib
import gc
import importlib
import os
import sys
from contextlib import suppress
from typing import Any, NoReturn

import click

from miniloop_cli.errors import MiniloopError, interrupted, out_of_memory
from miniloop_cli.runtime.allocator import keep_freed_memory
from miniloop_cli.runtime.kernel_cache import prepare_kernels_folder
from miniloop_cli.runtime.signals import heeded_interrupts
from miniloop_cli.version import __version__

PROGRAM = "miniloop"
# Imported objects stay alive, so frequent garbage collection costs time without any effect.
YOUNG_OBJECTS = 50_000
CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 100}

COMMANDS = {
    "register": "miniloop_cli.cli.register:register",
    "calibrate": "miniloop_cli.cli.calibrate:calibrate",
    "eval": "miniloop_cli.cli.eval:evaluate",
    "view": "miniloop_cli.cli.view:view",
    "compare": "miniloop_cli.cli.compare:compare",
    "plot": "miniloop_cli.cli.plot:plot",
    "export": "miniloop_cli.cli.export:export",
    "mesh": "miniloop_cli.cli.mesh:mesh",
    "add": "miniloop_cli.cli.add:add",
    "locate": "miniloop_cli.cli.locate:locate",
    "map": "miniloop_cli.cli.map:map_group",
    "inspect": "miniloop_cli.cli.inspect:inspect",
    "simulate": "miniloop_cli.cli.simulate:simulate",
    "demo": "miniloop_cli.cli.demo:demo",
    "bench": "miniloop_cli.cli.bench:bench",
    "config": "miniloop_cli.cli.config:config",
    "cache": "miniloop_cli.cli.cache:cache",
    "completion": "miniloop_cli.cli.completion:completion",
}


class LazyGroup(click.Group):
    """A group whose commands may be named by "module:attribute" and imported on use; suggests similar names."""

    def __init__(self, *args: Any, lazy: dict[str, str] | None = None, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.lazy = lazy or {}

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*self.commands, *self.lazy]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.lazy:
            return super().get_command(ctx, cmd_name)
        module, attribute = self.lazy[cmd_name].split(":")
        return getattr(importlib.import_module(module), attribute)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            near = difflib.get_close_matches(args[0], self.list_commands(ctx), n=1)
            hint = f" Did you mean '{near[0]}'?" if near else ""
            raise click.UsageError(f"{error.message}{hint}", ctx) from None


@click.group(cls=LazyGroup, lazy=COMMANDS, context_settings=CONTEXT)
@click.version_option(__version__, "-V", "--version", prog_name="miniloop")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
@click.pass_context
def cli(ctx: click.Context, debug: bool) -> None:
    """Poses and one consistent model from a set of RGB-D scans.

    \b
    Start here:   miniloop demo
    Your own:     miniloop register path/to/recording
    """
    ctx.obj = {"debug": debug}


def main(args: list[str] | None = None, command: click.Command = cli, program: str = PROGRAM) -> None:
    """Run the command line; exit status 0 done, 1 could not be done, 2 wrong usage, 130 interrupted."""
    args = sys.argv[1:] if args is None else args
    _open_closed_streams()
    gc.set_threshold(YOUNG_OBJECTS)
    keep_freed_memory()
    with heeded_interrupts():
        _run(command, args, program)


def _open_closed_streams() -> None:
    """Replace a missing stdout or stderr (services, windows without a console, `>&-`) by the null device."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # open until the process ends
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8"))


def _run(command: click.Command, args: list[str], program: str) -> None:
    debug = "--debug" in args or bool(os.environ.get("MINILOOP_DEBUG"))
    try:
        prepare_kernels_folder()
        # --debug is accepted at any position, as people append it to the command that failed.
        command.main(args=[arg for arg in args if arg != "--debug"], prog_name=program, standalone_mode=False)
        sys.stdout.flush()
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        _end_interrupted()
    except Exception as error:
        if interrupted(error):
            _end_interrupted()
        if debug or not (isinstance(error, (MiniloopError, OSError)) or out_of_memory(error)):
            raise
        if not isinstance(error, BrokenPipeError):  # then the reader of the output has closed it
            click.echo(f"miniloop: {_one_line(error)}", err=True)
        with suppress(OSError):  # the interpreter does not try again to print it at its end
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


def _end_interrupted() -> NoReturn:
    click.echo("miniloop: interrupted; finished work is kept, the same command continues", err=True)
    sys.exit(130)


def _one_line(error: Exception) -> str:
    """The message of an error that the user can act on."""
    if out_of_memory(error):
        return "out of memory: use fewer frames (--max-frames) or fewer jobs (--jobs 1)"
    return str(error)
