"""Mutual nearest neighbours with the ratio test by miniloop, OpenCV and faiss on the same descriptors, one thread."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import cv2
import faiss
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from benchmarks.side_by_side.clock import arguments, write_result
from miniloop_cli.datasets import open_sequence
from miniloop_cli.features.detect import comparable
from miniloop_cli.features.match import match
from miniloop_cli.presets import load_settings
from miniloop_cli.runtime.artifact_store import Store, default_folder
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.stages.extract import extract
from miniloop_cli.stages.run import Run

RATIO = 0.8
REPEATS = 3
Matcher = Callable[[NDArray, NDArray], NDArray[np.int64]]


def mutual(nearest: NDArray, distance: NDArray, back: NDArray, ratio: float) -> NDArray[np.int64]:
    """Pairs (k, 2) from the two nearest (n, 2) with distances (n, 2), and the nearest the other way (m,)."""
    rows = np.arange(len(nearest))
    good = (distance[:, 0] < ratio * distance[:, 1]) & (back[nearest[:, 0]] == rows)
    return np.stack([rows[good], nearest[good, 0]], axis=1)


def opencv(a: NDArray, b: NDArray) -> NDArray[np.int64]:
    """Brute force: knnMatch(k=2), Lowe's ratio, and a cross check by matching the other way."""
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING if a.dtype == np.uint8 else cv2.NORM_L2)
    forth = matcher.knnMatch(a, b, k=2)
    back = {m.queryIdx: m.trainIdx for m in matcher.match(b, a)}
    kept = [
        (best.queryIdx, best.trainIdx)
        for best, second in forth
        if best.distance < RATIO * second.distance and back[best.trainIdx] == best.queryIdx
    ]
    return np.array(kept, np.int64).reshape(-1, 2)


def opencv_one_way(a: NDArray, b: NDArray) -> NDArray[np.int64]:
    """Brute force with Lowe's ratio alone: half the work, more false matches."""
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING if a.dtype == np.uint8 else cv2.NORM_L2)
    forth = matcher.knnMatch(a, b, k=2)
    kept = [(m.queryIdx, m.trainIdx) for m, second in forth if m.distance < RATIO * second.distance]
    return np.array(kept, np.int64).reshape(-1, 2)


def faiss_flat(a: NDArray, b: NDArray) -> NDArray[np.int64]:
    """faiss' exact index, both ways. Its Euclidean distances are squared."""
    bits = a.dtype == np.uint8
    make = faiss.IndexBinaryFlat if bits else faiss.IndexFlatL2
    forth, back = make(8 * b.shape[1] if bits else b.shape[1]), make(8 * a.shape[1] if bits else a.shape[1])
    forth.add(b)
    back.add(a)
    distance, nearest = forth.search(a, 2)
    return mutual(nearest, distance, back.search(b, 1)[1][:, 0], RATIO if bits else RATIO * RATIO)


MATCHERS: dict[str, Matcher] = {
    "miniloop": lambda a, b: match(a, b, RATIO),
    "OpenCV BFMatcher": opencv,
    "OpenCV BFMatcher, ratio test one way only": opencv_one_way,
    "faiss flat index": faiss_flat,
}


def measure(descriptors: list[NDArray], pairs: list[tuple[int, int]]) -> list[dict[str, Any]]:
    """CPU milliseconds a pair, each pair's fastest of a few; matches a pair, and the share that miniloop finds too."""
    rows, ours = [], list[set[tuple[int, ...]]]()
    for name, matcher in MATCHERS.items():
        seconds, found = 0.0, []
        for i, j in pairs:
            a, b = descriptors[i], descriptors[j]
            times = []
            for _ in range(REPEATS):
                start = time.process_time()
                result = matcher(a, b)
                times.append(time.process_time() - start)
            seconds += min(times)
            found.append({tuple(row) for row in result.tolist()})
        ours = ours or found
        matches = sum(len(each) for each in found)
        same = sum(len(x & y) for x, y in zip(ours, found, strict=True)) / max(matches, 1)
        row = {"matcher": name, "ms": 1000 * seconds / len(pairs), "matches": matches / len(pairs)}
        rows.append(row | {"also_ours": same})
    return rows


def main() -> None:
    options = arguments(__doc__, pairs=40)
    sequence = open_sequence(options.sequence)
    rng = np.random.default_rng(0)
    chosen = rng.integers(0, len(sequence.frames), (options.pairs, 2))
    pairs = [(int(i), int(j)) for i, j in chosen if i != j]
    rows, run = [], Run(Store(default_folder()), Workers())
    for kind, counts in {"rootsift": (500, 1200, 2000), "orb": (1200, 2000)}.items():
        settings = load_settings(overrides=(f"features.type={kind}",))
        scans = extract(sequence, settings.features, settings.depth, run)
        descriptors = [comparable(found.descriptors[: found.with_depth], kind) for found in scans.features]
        cv2.setNumThreads(1)
        faiss.omp_set_num_threads(1)
        with threadpool_limits(1):
            for count in counts:
                fewer = [np.ascontiguousarray(d[:count]) for d in descriptors]
                measured = measure(fewer, pairs)
                size = float(np.mean([len(fewer[k]) for pair in pairs for k in pair]))
                rows += [{"features": kind, "count": count, "mean_count": size} | row for row in measured]
    write_result(options.out, {"rows": rows, "pairs": len(pairs)})


if __name__ == "__main__":
    main()
