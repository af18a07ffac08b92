"""Matches, edges and what was found by looking at scans, on disk: lists of arrays packed end to end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.runtime.artifact_store import Store, content_fingerprint, fingerprint
from miniloop_cli.scene.edge import VERDICTS, Edge, pairs_of
from miniloop_cli.scene.points import Matches
from miniloop_cli.typing import Pair

CHUNK = 1024  # pairs an artefact: what a killed run has to do again at most


def matches_by_chunk(
    pairs: Sequence[Pair], key: str, store: Store, make: Callable[[Sequence[Pair]], Matches]
) -> Matches:
    """Matches of all pairs, chunk by chunk from the store or made now."""
    found: Matches = {}
    for begin in range(0, len(pairs), CHUNK):
        chunk = pairs[begin : begin + CHUNK]
        chunk_key = fingerprint("matches", key, chunk)
        found |= _unpacked_matches(store.kept("matches", chunk_key, lambda chunk=chunk: _packed_matches(make(chunk))))
    return found


def _unpacked_matches(kept: Mapping[str, NDArray[Any]]) -> Matches:
    rows = np.split(kept["rows"].astype(np.int64), kept["ends"][:-1]) if len(kept["pairs"]) else []
    return {(int(i), int(j)): part for (i, j), part in zip(kept["pairs"], rows, strict=True)}


def _packed_matches(matches: Matches) -> dict[str, NDArray[Any]]:
    rows = list(matches.values())
    return {
        "pairs": np.array(list(matches), np.int32).reshape(-1, 2),
        "rows": np.concatenate([*rows, np.zeros((0, 2), int)]).astype(np.int32),
        "ends": np.cumsum([len(part) for part in rows], dtype=np.int64),
    }


def edges_kept(matches: Matches, key: str, store: Store, make: Callable[[], list[Edge]]) -> list[Edge]:
    """Solved edges from the store or made now; `matches` are those they were made from."""
    return _unpacked_edges(store.kept("edges", fingerprint("edges", key), lambda: _packed_edges(make())), matches)


def found_kept(key: str, store: Store, make: Callable[[], list[Edge]]) -> list[Edge]:
    """Edges with matches of their own, as a second round finds them, from the store or made now."""

    def packed() -> dict[str, NDArray[Any]]:
        edges = make()
        return _packed_edges(edges) | _packed_matches({(edge.i, edge.j): edge.matches for edge in edges})

    kept = store.kept("found", fingerprint("found", key), packed)
    return _unpacked_edges(kept, _unpacked_matches(kept))


def edges_fingerprint(edges: Sequence[Edge]) -> str:
    """Hash of the motions, matches and verdicts of edges; not of the words that say why."""

    def parts() -> Iterator[NDArray[Any]]:
        for begin in range(0, len(edges), CHUNK):  # one array an edge is slow, one of all edges large
            some = edges[begin : begin + CHUNK]
            yield np.array([(e.i, e.j, VERDICTS.index(e.verdict), len(e.matches)) for e in some], np.int64)
            yield np.concatenate([edge.matches for edge in some])
            yield np.concatenate([edge.inliers for edge in some])
            yield np.array([(edge.information, edge.covariance) for edge in some])
            yield np.array([edge.T_j_i for edge in some])

    return content_fingerprint(parts())


def _unpacked_edges(kept: Mapping[str, NDArray[Any]], matches: Matches) -> list[Edge]:
    pairs = [(int(i), int(j)) for i, j in kept["pairs"]]
    inliers = np.split(kept["inliers"], np.cumsum([len(matches[pair]) for pair in pairs])[:-1]) if pairs else []
    return [
        Edge(
            *pair,
            matches[pair],
            inliers[k],
            kept["T_j_i"][k],
            kept["information"][k],
            kept["covariance"][k],
            str(kept["solver"][k]),
            int(kept["cycle"][k]),
            int(kept["hypotheses"][k]),
            str(kept["verdict"][k]),
            str(kept["reason"][k]),
        )
        for k, pair in enumerate(pairs)
    ]


def _packed_edges(edges: Sequence[Edge]) -> dict[str, NDArray[Any]]:
    def column(name: str, shape: tuple[int, ...] = ()) -> NDArray[Any]:
        return np.array([getattr(edge, name) for edge in edges]).reshape(len(edges), *shape)

    return {
        "pairs": pairs_of(edges),
        "inliers": np.concatenate([*(edge.inliers for edge in edges), np.zeros(0, bool)]),
        "T_j_i": column("T_j_i", (4, 4)),
        "information": column("information", (6, 6)),
        "covariance": column("covariance", (6, 6)),
        **{name: column(name) for name in ("solver", "cycle", "hypotheses", "verdict", "reason")},
    }


def steps_kept(key: str, store: Store, make: Callable[[], list[float]]) -> list[float]:
    """The repetition of every scan (`steps_m`), from the store or made now."""
    steps_key = fingerprint("steps", key)
    return store.kept("steps", steps_key, lambda: {"step_m": np.array(make(), float)})["step_m"].tolist()
