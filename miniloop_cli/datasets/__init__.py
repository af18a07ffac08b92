"""Recordings on disk, in any layout: `open_sequence`, then `read_scan` frame by frame."""

from miniloop_cli.datasets.images import ImageFile
from miniloop_cli.datasets.layout import Layout
from miniloop_cli.datasets.open import open_sequence
from miniloop_cli.datasets.read import read_color, read_depth, read_ground_truth, read_scan
from miniloop_cli.datasets.registry import known_layouts
from miniloop_cli.datasets.trajectory import read_trajectory, write_trajectory

__all__ = [
    "ImageFile",
    "Layout",
    "known_layouts",
    "open_sequence",
    "read_color",
    "read_depth",
    "read_ground_truth",
    "read_scan",
    "read_trajectory",
    "write_trajectory",
]
