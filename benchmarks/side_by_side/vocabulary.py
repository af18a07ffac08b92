"""A vocabulary of ORB descriptors, learned from the recordings themselves, in DBoW2's text form.

Galvez-Lopez & Tardos, Bags of Binary Words for Fast Place Recognition in Image Sequences, T-RO 2012: a tree whose
nodes are medians of bits, found by k-means++ at every node.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

BRANCHES, LEVELS = 10, 6  # ORB-SLAM's
SMALLEST = 20  # nodes of fewer descriptors are not divided
SHALLOWEST = 3  # ORB-SLAM groups features by nodes of level 2: no word lies above
ROUNDS = 8
FEATURES = 1000  # an image
KINDS = "0 0"  # scores by L1, weights tf-idf: the numbers of DBoW2's enumerations


@dataclass(frozen=True)
class Vocabulary:
    """Nodes in the order of their numbers, from 1; node 0 is the root."""

    parent: NDArray[np.int64]  # (nodes,)
    word: NDArray[np.bool_]  # (nodes,) leaves
    descriptor: NDArray[np.uint8]  # (nodes, 32)
    levels: int
    weight: NDArray[np.float64]  # (nodes,) 0 but for words: log of images over images with this word


def orb_descriptors(paths: Iterable[Path]) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """(n, 32) descriptors of all images, and (n,) which image each is of."""
    import cv2

    orb = cv2.ORB_create(FEATURES, 1.2, 8, fastThreshold=10)
    found = [orb.detectAndCompute(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), None)[1] for path in paths]
    found = [np.empty((0, 32), np.uint8) if each is None else each for each in found]
    return np.concatenate(found), np.repeat(np.arange(len(found)), [len(each) for each in found])


def train(descriptors: NDArray[np.uint8], image: NDArray[np.int64], rng: Generator, levels: int = LEVELS) -> Vocabulary:
    """The tree of (n, 32) descriptors, (n,) of which image each; the same generator, the same tree."""
    bits = np.unpackbits(descriptors, axis=1).astype(np.float32)
    images = len(np.unique(image))
    parent, word, median, weight = list[int](), list[bool](), list[NDArray](), list[float]()
    level = [(0, np.arange(len(bits)))]
    for depth in range(1, levels + 1):
        divided = []
        for node, members in level:
            groups = _divided(bits[members], rng)
            for group in groups:
                inside = members[group]
                few = len(groups) == 1 or len(inside) < SMALLEST
                is_word = depth == levels or (depth >= min(SHALLOWEST, levels) and few)
                parent.append(node)
                word.append(is_word)
                median.append(_median(bits[inside]))
                weight.append(float(np.log(images / len(np.unique(image[inside])))) if is_word else 0.0)
                if not is_word:
                    divided.append((len(parent), inside))
        level = divided
    packed = np.packbits(np.array(median, bool).reshape(-1, 256), axis=1)
    return Vocabulary(np.array(parent, np.int64), np.array(word, bool), packed, levels, np.array(weight, float))


def write(path: Path, vocabulary: Vocabulary) -> None:
    """DBoW2's text form. No newline at the end: readers that go on to the end of the file would take it for a node."""
    rows = [f"{BRANCHES} {vocabulary.levels} {KINDS}"]
    nodes = zip(vocabulary.parent, vocabulary.word, vocabulary.descriptor, vocabulary.weight, strict=True)
    for parent, word, descriptor, weight in nodes:
        rows.append(f"{parent} {int(word)} {' '.join(map(str, descriptor))} {weight:.6g}")
    path.write_text("\n".join(rows), encoding="ascii")


def _median(bits: NDArray[np.float32]) -> NDArray[np.bool_]:
    return bits.mean(axis=0) >= 0.5


def _distances(bits: NDArray[np.float32], centres: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n, k) numbers of bits that differ."""
    return bits.sum(axis=1)[:, None] + centres.sum(axis=1) - 2 * bits @ centres.T


def _divided(bits: NDArray[np.float32], rng: Generator) -> list[NDArray[np.int64]]:
    """Rows of (n, 256) bits in up to BRANCHES groups, none empty."""
    centres = bits[rng.integers(len(bits))][None]
    nearest = _distances(bits, centres)[:, 0]
    while len(centres) < BRANCHES and nearest.any():
        squared = nearest.astype(float) ** 2
        chosen = bits[rng.choice(len(bits), p=squared / squared.sum())][None]
        centres = np.concatenate([centres, chosen])
        nearest = np.minimum(nearest, _distances(bits, chosen)[:, 0])
    group = np.full(len(bits), -1)
    for _ in range(ROUNDS):
        before, group = group, _distances(bits, centres).argmin(axis=1)
        if (group == before).all():
            break
        for k in np.unique(group):
            centres[k] = _median(bits[group == k])
    return [np.flatnonzero(group == k) for k in np.unique(group)]
