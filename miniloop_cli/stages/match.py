"""Stage: matches of features between scans."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.config import Matching, PosePrior
from miniloop_cli.features.detect import compact
from miniloop_cli.features.retrieval import DESCRIBED_FEATURES, around
from miniloop_cli.scene.points import Matches
from miniloop_cli.scene.priors import Priors
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.stages.artifacts import MATCHES
from miniloop_cli.stages.candidates import comparer, listed_pairs, retrieved_pairs
from miniloop_cli.stages.run import Run
from miniloop_cli.typing import Pair
from miniloop_cli.verification.pose_prior import pairs_by_pose_prior

LOG = logging.getLogger("miniloop")
CHUNK = 1024  # pairs an artefact, at most lost by a killed run


def match(scans: ScanSet, settings: Matching, pose_prior: PosePrior, priors: Priors, run: Run) -> Matches:
    """Matches of the pairs by the settings; in a long recording first of retrieved pairs, then around its loops.

    With a pose prior, its pairs replace all pairs or the retrieved ones.
    """
    found = _compared(scans, settings, pose_prior, priors, run)
    if settings.edge_share == 0:
        return found
    least = max(min_matches_for(found, settings.edge_share, len(scans)), settings.min_matches)
    LOG.info("T = %d matches, so that %.3g of all pairs become edges", least, settings.edge_share)
    return {pair: rows for pair, rows in found.items() if len(rows) >= least}


def min_matches_for(matches: Matches, edge_share: float, scans: int) -> int:
    """The T of the paper whose overlap graph has the share of all pairs nearest to `edge_share`."""
    counts = np.array([len(rows) for rows in matches.values()])
    candidates = np.unique(counts)
    if not len(candidates):
        return 0
    edges = (counts >= candidates[:, None]).sum(axis=1)
    return int(candidates[np.abs(edges - edge_share * scans * (scans - 1) / 2).argmin()])


def _compared(scans: ScanSet, settings: Matching, pose_prior: PosePrior, priors: Priors, run: Run) -> Matches:
    """Matches of all pairs by the settings that have `min_matches`."""
    compare = comparer(scans, settings, run.workers)

    def matched(pairs: Sequence[Pair]) -> Matches:
        return _by_chunk(pairs, (scans.key, settings), run, compare)

    if settings.pairs == "auto" and priors.T_world_cam is not None:
        return matched(pairs_by_pose_prior(priors.T_world_cam, scans.points, scans.camera, pose_prior))
    if settings.pairs != "auto" or len(scans) <= settings.exhaustive_max_scans:
        return matched(listed_pairs(len(scans), settings.pairs, settings))
    small = [compact(scan.descriptors[:DESCRIBED_FEATURES], scans.feature_type)[0] for scan in scans.features]
    pairs = retrieved_pairs(small, settings, np.random.default_rng(0))
    found = matched(pairs)
    loops = [(i, j) for i, j in found if j - i > settings.sequential_window]
    return found | matched(sorted(around(loops, len(scans)) - set(pairs)))


def _by_chunk(pairs: Sequence[Pair], how: Any, run: Run, compare: Callable[[Sequence[Pair]], Matches]) -> Matches:
    """Matches of all pairs, chunk by chunk from the cache or computed."""
    found: Matches = {}
    for begin in range(0, len(pairs), CHUNK):
        chunk = pairs[begin : begin + CHUNK]

        def make(chunk: Sequence[Pair] = chunk) -> dict[str, NDArray[Any]]:
            return match_arrays(compare(chunk))

        found |= matches_from_arrays(run.store.cached(MATCHES, (how, chunk), make))
    return found


def match_arrays(matches: Matches) -> dict[str, NDArray[Any]]:
    """Matches as `pairs` (m, 2), `rows` (k, 2) of all pairs one after the other, and the `ends` (m,) of these rows."""
    rows = list(matches.values())
    return {
        "pairs": np.array(list(matches), np.int32).reshape(-1, 2),
        "rows": np.concatenate([*rows, np.zeros((0, 2), int)]).astype(np.int32),
        "ends": np.cumsum([len(part) for part in rows], dtype=np.int64),
    }


def matches_from_arrays(arrays: Mapping[str, NDArray[Any]]) -> Matches:
    """The matches, rows (k, 2) a pair, of the arrays of `match_arrays`."""
    rows = np.split(arrays["rows"].astype(np.int64), arrays["ends"][:-1]) if len(arrays["pairs"]) else []
    return {(int(i), int(j)): part for (i, j), part in zip(arrays["pairs"], rows, strict=True)}
