"""Retrieval of keyframes that look similar to an image: VLAD vectors over a vocabulary stored in the map."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.features.detect import compact
from miniloop_cli.features.retrieval import DESCRIBED_FEATURES, described, vocabulary
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.scene_map import Retrieval
from miniloop_cli.typing import Bytes, Floats32, Ints

TRAINING = 5000  # descriptors for learning the words: more make maps slow to write


def small(descriptors: NDArray, feature_type: str) -> Bytes:
    """The strongest descriptors (n, d) of an image as bytes, for the vocabulary."""
    return compact(descriptors[:DESCRIBED_FEATURES], feature_type)[0]


def index(keyframes: Sequence[ScanFeatures], feature_type: str, learnt_from: int) -> Retrieval:
    """The index of keyframes; the vocabulary is learnt from the first `learnt_from` of them."""
    descriptors = [small(features.descriptors, feature_type) for features in keyframes[:learnt_from]]
    words = vocabulary(descriptors, np.random.default_rng(0), TRAINING)
    return extended(Retrieval(words, np.zeros((0, words.size), np.float32)), keyframes, feature_type)


def extended(before: Retrieval, keyframes: Sequence[ScanFeatures], feature_type: str) -> Retrieval:
    """The index with more keyframes. Vectors have the precision of stored ones."""
    vectors = described([small(features.descriptors, feature_type) for features in keyframes], before.words)
    kept = vectors.astype(np.float16).astype(np.float32)
    return Retrieval(before.words, np.concatenate([before.vectors.reshape(-1, kept.shape[1]), kept]))


def most_similar(vectors: Floats32, query: Floats32, most: int) -> Ints:
    """Numbers of the `most` vectors (K, d) that are most alike to one (d,), the most similar first."""
    return np.argsort(-(vectors @ query), kind="stable")[:most]
