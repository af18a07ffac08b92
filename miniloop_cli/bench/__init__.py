"""The paper's experiments: functions from options to rows, and from rows to a picture."""

from __future__ import annotations

from typing import Any

Row = dict[str, Any]
