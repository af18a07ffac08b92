"""The templates of the page; Python gives them plain values, and only they contain markup."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jinja2 import Environment


@cache
def environment() -> Environment:
    """The templates of this package: every value is escaped, and a missing name is an error."""
    # Imported here, so that commands without a report start faster.
    from jinja2 import Environment, PackageLoader, StrictUndefined

    templates = Environment(
        loader=PackageLoader("miniloop_cli.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    return templates


def render(template: str, **values: Any) -> str:
    """A template of this package, filled in. Raises jinja2.UndefinedError for a missing value."""
    return environment().get_template(template).render(values)


def asset(name: str) -> str:
    """The text of a file of this package."""
    return files("miniloop_cli.report").joinpath(name).read_text(encoding="utf-8")
