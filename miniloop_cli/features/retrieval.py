"""Image retrieval: one compact vector (VLAD) for each image, from its features.

Jégou et al., "Aggregating local descriptors into a compact image representation", CVPR 2010: descriptors are assigned
to the words of a small vocabulary, the residuals of each word are summed, signed square roots taken, and the vector
normalised. The vocabulary is learnt from the recording.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from miniloop_cli.typing import Bytes, Floats32, Ints, Pair

WORDS = 32
TRAINING_DESCRIPTORS = 20_000  # descriptors that the vocabulary is learnt from
DESCRIBED_FEATURES = 300  # features of an image that describe it
FAISS_FROM = 10_000  # images from which faiss is faster than a matrix product


def image_vectors(descriptors: Sequence[Bytes], rng: np.random.Generator) -> Floats32:
    """(n, WORDS * d) unit vectors of n images from their (k, d) compact descriptors; zero for images without any."""
    return described(descriptors, vocabulary(descriptors, rng))


def vocabulary(
    descriptors: Sequence[Bytes], rng: np.random.Generator, training: int = TRAINING_DESCRIPTORS
) -> Floats32:
    """(WORDS, d) words learnt from the (k, d) compact descriptors of images; (0, d) where these have too few.

    `training`: descriptors that they are learnt from, at most.
    """
    from scipy.cluster.vq import kmeans2

    strongest = [found[:DESCRIBED_FEATURES].astype(np.float32) for found in descriptors if len(found)]
    width = max((found.shape[1] for found in strongest), default=1)
    everything = np.concatenate([np.zeros((0, width), np.float32), *strongest])
    if len(everything) < WORDS:
        return np.zeros((0, width), np.float32)
    sample = everything[rng.permutation(len(everything))[:training]]
    return kmeans2(sample, WORDS, iter=10, minit="++", rng=rng)[0]


def described(descriptors: Sequence[Bytes], words: Floats32) -> Floats32:
    """(n, WORDS * d) unit vectors of n images from their (k, d) compact descriptors, over the words (WORDS, d).

    Zero for images without any descriptors, and where there are no words.
    """
    from scipy.cluster.vq import vq

    vectors = np.zeros((len(descriptors), WORDS, words.shape[1]), np.float32)
    for vector, found in zip(vectors, descriptors, strict=True):
        if len(found) and len(words):
            strongest = found[:DESCRIBED_FEATURES].astype(np.float32)
            nearest, _ = vq(strongest, words)
            np.add.at(vector, nearest, strongest - words[nearest])
    flat = vectors.reshape(len(vectors), -1)
    flat = np.sign(flat) * np.sqrt(np.abs(flat))
    return flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-12)


def similar_pairs(vectors: Floats32, most: int, faiss_from: int = FAISS_FROM) -> list[Pair]:
    """Pairs (i, j), i < j, of each image with the `most` images that look most alike, sorted.

    vectors (n, d), of length 1; faiss, where installed, searches them if there are at least `faiss_from`.
    """
    count = len(vectors)
    nearest = _nearest(vectors, min(most + 1, count), faiss_from)
    return sorted({(min(i, int(j)), max(i, int(j))) for i in range(count) for j in nearest[i] if i != j and j >= 0})


def _nearest(vectors: Floats32, most: int, faiss_from: int) -> Ints:
    if len(vectors) >= faiss_from:
        try:
            import faiss
        except ImportError:
            pass
        else:
            index = faiss.IndexFlatIP(vectors.shape[1])
            index.add(vectors)
            return index.search(vectors, most)[1]
    blocks = []
    for first in range(0, len(vectors), 512):
        similarity = vectors[first : first + 512] @ vectors.T
        blocks.append(np.argsort(-similarity, axis=1, kind="stable")[:, :most])
    return np.concatenate(blocks) if blocks else np.zeros((0, most), np.int64)


def around(loops: Iterable[Pair], count: int, reach: int = 2) -> set[Pair]:
    """Pairs of frames within `reach` of the given pairs, as the neighbours of a loop overlap as well."""
    near = set()
    for i, j in loops:
        for a in range(max(i - reach, 0), min(i + reach + 1, count)):
            for b in range(max(j - reach, 0), min(j + reach + 1, count)):
                if a != b:
                    near.add((min(a, b), max(a, b)))
    return near
