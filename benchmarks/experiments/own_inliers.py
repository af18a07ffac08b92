"""Edges judged by their own inliers alone, whatever averaging made of them."""

from __future__ import annotations

from miniloop_cli.config import Verification
from miniloop_cli.ransac.cycle_edges import judge
from miniloop_cli.scene.edge import EdgeTable


def judged_by_inliers(edges: EdgeTable, settings: Verification) -> EdgeTable:
    """The same edges, each with the verdict that its inliers give it before any other edge is asked."""
    return EdgeTable.of([judge(edge, settings) for edge in edges.edges()])
