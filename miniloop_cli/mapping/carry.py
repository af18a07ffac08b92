"""From keyframes to all frames: frames move with their neighbouring keyframes."""

from __future__ import annotations

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.scene.scene_map import MapPart, SceneMap
from miniloop_cli.typing import Floats


def carried_poses(part: MapPart, T_world_key: Floats) -> Floats:
    """(n, 4, 4) poses of all registered frames of a recording, for given poses (k, 4, 4) of its keyframes.

    A frame between two keyframes keeps its motion since the earlier one; the error at the later one is spread evenly
    over the time between them. Frames before the first and after the last keyframe move with it.
    """
    own, keys = part.T_world_cam, part.keyframe
    before = np.clip(np.searchsorted(keys, np.arange(len(own)), side="right") - 1, 0, len(keys) - 1)
    after = np.minimum(before + 1, len(keys) - 1)
    moved = T_world_key @ se3.inverse(own[keys])
    missed = se3.inverse(own[keys[after]]) @ se3.inverse(moved[before]) @ T_world_key[after]
    t0, t1 = part.stamps_s[keys[before]], part.stamps_s[keys[after]]
    share = np.clip((part.stamps_s - t0) / np.where(t1 > t0, t1 - t0, 1.0), 0.0, 1.0)
    turn = se3.exp_so3(share[:, None] * se3.log_so3(missed[:, :3, :3]))
    return moved[before] @ own @ se3.pose(turn, share[:, None] * missed[:, :3, 3])


def map_trajectories(scene_map: SceneMap) -> list[Floats]:
    """Poses (n, 4, 4) of the registered frames of each recording, in the world of its piece."""
    T = scene_map.joined.T_world_cam
    return [carried_poses(part, T[scene_map.keyframes_of(r)]) for r, part in enumerate(scene_map.parts)]
