"""Whether two machines run the same code."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from pathlib import Path

from miniloop_cli.runtime.artifact_store import library_versions


@cache
def code_version() -> str:
    """Hash of the package's sources and the libraries' versions: equal where the same inputs give the same bytes."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256(json.dumps(library_versions()).encode())
    for path in sorted(package.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
