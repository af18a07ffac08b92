"""Retrieval of scans that look alike."""

import numpy as np
import pytest

from miniloop_cli.features.retrieval import similar_pairs


def test_faiss_retrieves_what_the_product_of_matrices_does(monkeypatch):
    faiss = pytest.importorskip("faiss", reason="needs the extra [scale]")
    vectors = np.random.default_rng(0).normal(size=(300, 64)).astype(np.float32)
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    expected = similar_pairs(vectors, 7)
    searched = []

    class Index(faiss.IndexFlatIP):
        def search(self, *arguments):
            searched.append(True)
            return super().search(*arguments)

    monkeypatch.setattr(faiss, "IndexFlatIP", Index)
    assert similar_pairs(vectors, 7, faiss_from=100) == expected
    assert searched
