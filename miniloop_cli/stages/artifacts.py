"""The kinds of cached results of stages, each with the version of what its stage computes.

Raise the version of a kind whenever the same inputs give other content than before; a test watches the code.
"""

from __future__ import annotations

from miniloop_cli.runtime.artifact_store import Artifact

PROBED = Artifact("probed", 6)
TRACKED = Artifact("tracked", 20)
FEATURES = Artifact("features", 1)
MATCHES = Artifact("matches", 1)
EDGES = Artifact("edges", 2)
REPETITION = Artifact("repetition", 1)
GUIDED = Artifact("guided", 2)
REFINED = Artifact("refined", 16)
SECOND_MODES = Artifact("second_modes", 1)
JOINED = Artifact("joined", 9)
