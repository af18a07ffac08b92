"""The kinds of finished work that stages keep, each with the version of what its stage computes.

Change the version of a kind whenever the same inputs give another content than before; a test watches the code.
"""

from __future__ import annotations

from miniloop_cli.runtime.artifact_store import Artifact

FEATURES = Artifact("features", 1)
MATCHES = Artifact("matches", 1)
EDGES = Artifact("edges", 1)
REPETITION = Artifact("repetition", 1)
GUIDED = Artifact("guided", 1)
REFINED = Artifact("refined", 1)
