"""Depth at the features of scans, read again with better known cameras of colour and depth."""

from __future__ import annotations

from functools import cache

import numpy as np

from miniloop_cli.config import Depth
from miniloop_cli.datasets.read import read_own_depth
from miniloop_cli.errors import InputError
from miniloop_cli.features.ray_depth import depth_on_rays
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.refinement.two_cameras import DepthReader
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.sequence import DepthCamera, Sequence
from miniloop_cli.typing import Floats, Floats32, Ints


def depth_reader(sequence: Sequence, depth: Depth, workers: Workers) -> DepthReader:
    """A function that reads depth at pixels of the frames; unreadable frames have none.

    It keeps the depth images in memory, about a megabyte a frame.
    """

    @cache
    def image(number: int) -> Floats32 | None:
        try:
            return read_own_depth(sequence, number)
        except InputError:
            return None

    def read_depth(color: Camera, own: DepthCamera, frame: Ints, px: Floats) -> tuple[Floats, Floats]:
        order = np.argsort(frame, kind="stable")
        numbers, start = np.unique(frame[order], return_index=True)
        rows = np.split(order, start[1:])

        def of_frame(item: tuple[int, Ints]) -> tuple[Floats, Floats]:
            number, mine = item
            depth_m = image(number)
            if depth_m is None:
                return np.full(len(mine), np.nan), np.zeros((len(mine), 2))
            return depth_on_rays(depth_m, px[mine], color, own, depth)

        z_m, slope = np.full(len(frame), np.nan), np.zeros((len(frame), 2))
        items = list(zip(numbers.tolist(), rows, strict=True))
        found = Workers(workers.jobs, quiet=True).map(of_frame, items, "looking up depth", len(items))
        for mine, (readings, along) in zip(rows, found, strict=True):
            z_m[mine], slope[mine] = readings, along
        return z_m, slope

    return read_depth
