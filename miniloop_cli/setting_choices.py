"""Settings with a fixed set of values: their annotation, and the values."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, get_args

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, PydanticCustomError, core_schema


class OneOf:
    """Marks a string as one of the names in a table, which a Literal would repeat."""

    def __init__(self, names: Iterable[str]) -> None:
        self.names = names

    def check(self, value: str) -> str:
        """The value. Raises pydantic's error for one that is not among the names."""
        if value not in self.names:
            *others, last = map(repr, self.names)
            raise PydanticCustomError("literal_error", f"Input should be {', '.join(others)} or {last}")
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return handler(schema) | {"enum": list(self.names)}


def choices(field: FieldInfo) -> tuple[Any, ...]:
    """The values of a setting with a fixed choice; else none."""
    named = [item for item in field.metadata if isinstance(item, OneOf)]
    if named:
        return tuple(named[0].names)
    # A union of names and a switch: Literal["auto"] | bool.
    return tuple(value for part in get_args(field.annotation) for value in _values(part))


def _values(part: Any) -> tuple[Any, ...]:
    return (True, False) if part is bool else get_args(part) or (part,)
