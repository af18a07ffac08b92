"""Files that are either whole or absent: written under a temporary name, then renamed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from miniloop_cli.errors import MiniloopError


@contextmanager
def atomic_write(path: Path, mode: str = "w") -> Iterator[IO]:
    """Open a temporary neighbour of `path`; on success it replaces `path`, on any error it is removed.

    Raises MiniloopError if the folder cannot be written (no permission, disk full).
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open(mode, **({} if "b" in mode else {"encoding": "utf-8", "newline": "\n"})) as file:
            yield file
            file.flush()
        temporary.replace(path)
    except OSError as error:
        raise MiniloopError(f"cannot write {path}: {error.strerror or error}; free some space or choose -o") from error
    finally:
        temporary.unlink(missing_ok=True)
