"""`miniloop completion SHELL`, and the completions: presets, settings, layouts."""

from __future__ import annotations

import click
from click.shell_completion import CompletionItem

from miniloop_cli.cli.main import CONTEXT, PROGRAM, cli

# The file of the script for each shell.
FILES = {
    "bash": "~/.local/share/bash-completion/completions/miniloop",
    "zsh": "~/.zfunc/_miniloop   (with: fpath+=~/.zfunc before compinit in ~/.zshrc)",
    "fish": "~/.config/fish/completions/miniloop.fish",
}


@click.command(
    context_settings=CONTEXT,
    short_help="Completion script for bash, zsh or fish.",
    epilog="\b\nSave it to:\n" + "\n".join(f"{k:<5} {v}" for k, v in FILES.items()),
)
@click.argument("shell", type=click.Choice(list(FILES)))
def completion(shell: str) -> None:
    """Print the completion script of a shell: commands, options, presets, settings and files by the tab key.

    \b
    Example:   source <(miniloop completion bash)     # for this session
    """
    from click.shell_completion import get_completion_class

    kind = get_completion_class(shell)
    if kind is None:  # cannot happen for the three choices
        raise click.UsageError(f"no completion for {shell}")
    script = kind(cli, {}, PROGRAM, f"_{PROGRAM.upper()}_COMPLETE").source()
    # zsh has loaded the file by the second press of the tab key: click's test fails then, and nothing is completed.
    click.echo(script.replace("$zsh_eval_context[-1] == loadautofunc", f'"$funcstack[1]" == _{PROGRAM}'))


def complete_preset(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Presets with this prefix; else files."""
    from miniloop_cli.presets import PRESETS

    found = [CompletionItem(name) for name in PRESETS if name.startswith(incomplete)]
    return found or [CompletionItem(incomplete, type="file")]


def complete_key(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Dotted keys of settings with this prefix, and their meaning for shells that show it."""
    from miniloop_cli.presets import keys

    return [CompletionItem(k, help=field.description) for k, field in keys().items() if k.startswith(incomplete)]


def complete_assignment(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """`key=`, or once the key is whole, `key=value` for settings with a fixed choice."""
    from miniloop_cli.presets import keys
    from miniloop_cli.setting_choices import choices

    key, equals, begun = incomplete.partition("=")
    if not equals:
        return [CompletionItem(f"{item.value}=", help=item.help) for item in complete_key(ctx, param, key)]
    field = keys().get(key)
    named = map(str, choices(field)) if field else ()
    return [CompletionItem(f"{key}={choice}") for choice in named if choice.startswith(begun)]


def complete_layout(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Layouts of recordings with this prefix."""
    from miniloop_cli.datasets import known_layouts

    return [CompletionItem(name) for name in known_layouts() if name.startswith(incomplete)]
