"""The front end of whole recordings: points tracked through frames, the motion from them, and the keyframes.

Points are tracked from the last keyframe, not from frame to frame, so that their positions do not drift. A frame
becomes a keyframe when few of the last one's points are left, so that the following frames share many points with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from miniloop_cli.config import Depth, Tracking
from miniloop_cli.features.keypoints3d import depth_at, depth_slope, on_outline
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.sequence import Scan, Sequence
from miniloop_cli.scene.tracked import Link, Observations, TrackedPart, TrackStatus
from miniloop_cli.tracking.choice import FEW_POINTS, choose, few, with_lag
from miniloop_cli.tracking.depth_alone import Seen, seen_motion
from miniloop_cli.tracking.flow import contrasts, follow, new_corners
from miniloop_cli.tracking.frames import TrackFrame, readable_frames, told_apart
from miniloop_cli.tracking.motion import MIN_HELPED, NOTHING_MEASURED, Measured, Motion, frame_motion
from miniloop_cli.tracking.surface import Surface, make_surface
from miniloop_cli.typing import Bools, Bytes, Floats, Floats32, Ints

MAX_PREDICTED_S = 0.2  # longest time over which a motion is extrapolated
SURE_SHARE = 0.2  # of the points that must agree without depth, as a dozen can agree by chance
MIN_SURFACE = 0.6  # of a frame's cells with depth that the keyframe must also see
NO_POINTS = np.zeros((0, 2), np.float32)
STILL_PX = 0.3  # points that move less, in the median, may be a pattern of the sensor
OUTLINE_PX = 7.0  # half of the window by which a point is followed


def track_part(sequence: Sequence, depth: Depth, settings: Tracking, first: int, last: int) -> TrackedPart:
    """Track points through the frames first..last; both ends are keyframes if they can be read and have depth."""
    part = TrackedPart.of(first, last)
    tracker = _Tracker(sequence.camera, depth, settings, part)
    for frame in told_apart(readable_frames(sequence, range(first, last + 1), part), part):
        tracker.add(frame, frame.number == last)
    keyframe = int((part.status == TrackStatus.KEYFRAME).argmax())
    if keyframe > 0 and (part.status[:keyframe] == TrackStatus.NO_DEPTH).any():
        # Colour may begin before depth: frames before the first keyframe are tracked backwards from it.
        backwards = _Tracker(sequence.camera, depth, settings, part, tracker.tracks)
        for frame in readable_frames(sequence, range(first + keyframe, first - 1, -1), part):
            backwards.add(frame, False)
    return part


@dataclass
class _Key:
    """The keyframe of the tracked points: their pixels and contrast in its image, their points in its camera.

    p_key is NaN without depth.
    """

    frame: TrackFrame
    px: Floats32
    contrast: Floats32
    p_key: Floats
    count: int
    surface: Surface | None = None  # made when it is needed


class _Followed(NamedTuple):
    """Points of the keyframe in another image: their rows (n,) there, pixels (n, 2); those with depth there are
    measured."""

    rows: Ints
    px: Floats32
    measured: Measured

    def still(self, key: _Key) -> bool:
        """Whether they stay where they are in the image: then they may be a pattern of the sensor."""
        return len(self.rows) >= MIN_HELPED and bool(np.median(np.abs(self.px - key.px[self.rows])) < STILL_PX)


class _Tracker:
    """Processes one frame after the other, and writes the results into a part.

    Row k of the points (`_px`, `_track`, the key's px and p_key) is the same point. `_found`: the points were found in
    the last frame; else they have their last known positions. `tracks`: number of tracks of the part.
    """

    def __init__(self, camera: Camera, depth: Depth, settings: Tracking, part: TrackedPart, tracks: int = 0) -> None:
        self._camera, self._depth, self._settings, self._part = camera, depth, settings, part
        self._key: _Key | None = None
        self._last: TrackFrame | None = None  # the last frame, if it can become a keyframe
        self._px, self._track = NO_POINTS, np.zeros(0, np.int64)
        self._found, self.tracks = False, tracks
        self._T_cam_key = np.eye(4)
        self._step, self._step_s = np.eye(4), 0.0  # the camera's motion in the last frame, and over how many seconds
        self._stamp_s = 0.0
        self._before: Bytes = np.zeros((0, 0), np.uint8)  # the image of the last frame

    def add(self, frame: TrackFrame, last: bool) -> None:
        """Link a frame to the last keyframe, or make it a keyframe; the `last` one becomes one in any case."""
        link, enough = self._tried(frame)
        followed = link is not None and link.determined
        if self._key and link:
            # Also a motion that is known in part takes part in the adjustment, if other things tell the frame's pose.
            self._part.link(frame.number, self._key.frame.number, link)
        if link and followed:
            self._part.set(frame.number, TrackStatus.FOLLOWED)
            # The motion from a surface is too inaccurate to be extrapolated.
            self._step_s = 0.0 if link.by_surface else abs(frame.stamp_s - self._stamp_s)
            self._step = link.T_cam_key @ se3.inverse(self._T_cam_key)
            self._T_cam_key = link.T_cam_key
        if not followed or not enough or last:
            if frame.has_depth:
                self._make_key(frame)
            elif not followed:
                text = "the image has no depth, and no points tie it to a keyframe"
                self._part.set(frame.number, TrackStatus.NO_DEPTH, text)
        self._last = frame if followed and self._key and self._key.frame is not frame and frame.has_depth else None
        self._stamp_s, self._before = frame.stamp_s, frame.gray
        if self._found:
            self._observe(frame)

    def _tried(self, frame: TrackFrame) -> tuple[Link | None, bool]:
        """As `_linked`; where the keyframe does not tell the motion, the last frame becomes one, as it is nearer."""
        if self._key is None:
            return None, False
        there = self._px, self._track, self._found
        self._found = False
        link, enough = self._linked(frame, self._key)
        if (link and link.determined) or self._last is None:
            return link, enough
        (self._px, self._track, self._found), known = there, self.tracks
        self._make_key(self._last)
        self._observe(self._last, known)
        self._found = False
        return self._linked(frame, self._key)

    def _linked(self, frame: TrackFrame, key: _Key) -> tuple[Link | None, bool]:
        """The motion since the keyframe, None if nothing tells it; whether the next frame can be linked to it, too."""
        predicted = self._predicted(abs(frame.stamp_s - self._stamp_s))
        points = self._followed(frame, key, predicted)
        motion = frame_motion(points.measured, predicted, self._camera)
        if motion and not (frame.has_depth or motion.agrees.sum() >= SURE_SHARE * len(key.px)):
            motion = None
        surface, on_sensor, measured, still = None, False, points.measured, points.still(key)
        if frame.has_depth and (few(motion) or still):
            start = motion.T_cam_key if motion and not still else predicted
            surface, on_sensor = self._by_surface(frame, key, start, still)
            if on_sensor:
                motion, measured = None, NOTHING_MEASURED
        link, motion = choose(measured, motion, surface, self._camera)
        if motion:
            self._keep(key, points, motion)
        enough = self._found and len(self._px) >= self._settings.min_followed * key.count
        if link and link.surface and surface and surface.overlap > MIN_SURFACE:
            # Where points can be followed again, a new keyframe begins.
            enough |= on_sensor or not self._has_points(frame)
        return link, enough

    def _followed(self, frame: TrackFrame, key: _Key, predicted: Floats) -> _Followed:
        """The points of the keyframe that are found in this image."""
        before, after = key.frame.gray, frame.gray
        found, good = follow(before, after, key.px, key.contrast, self._guess(key, predicted), sure=True)
        if good.sum() < 0.5 * len(key.px):
            again, good_again = follow(before, after, key.px, key.contrast, self._px, sure=False)
            if good_again.sum() > good.sum():
                found, good = again, good_again
        rows = np.flatnonzero(good)
        px = found[rows].astype(float)
        deep = np.isfinite(key.p_key[rows, 2])
        z_m = depth_at(frame.scan.depth_m, px, self._depth)
        measured = Measured(key.p_key[rows][deep], self._camera.undistort(px)[deep], z_m[deep])
        return _Followed(rows, found[rows], measured)

    def _keep(self, key: _Key, points: _Followed, motion: Motion) -> None:
        """Go on with the points that agree with the motion, and those whose depth the keyframe does not tell."""
        agrees = np.isnan(key.p_key[points.rows, 2])
        agrees[~agrees] = motion.agrees
        rows = points.rows[agrees]
        key.px, key.contrast, key.p_key = key.px[rows], key.contrast[rows], key.p_key[rows]
        self._px, self._track, self._found = points.px[agrees], self._track[rows], True

    def _by_surface(self, frame: TrackFrame, key: _Key, start: Floats, still: bool) -> Seen:
        """The motion since the keyframe by depth and brightness.

        The lag of depth makes it less certain, unless points stand `still`.
        """
        key.surface = key.surface or make_surface(key.frame.scan, key.frame.gray, self._camera, self._depth)
        now = make_surface(frame.scan, frame.gray, self._camera, self._depth)
        motion, on_sensor = seen_motion(key.surface, now, start, still)
        if motion is None or (still and not on_sensor):
            return Seen(motion, on_sensor)
        step = motion.T_cam_key @ se3.inverse(self._T_cam_key)
        information = with_lag(motion.information, step, abs(frame.stamp_s - self._stamp_s))
        return Seen(motion._replace(information=information), on_sensor)

    def _has_points(self, frame: TrackFrame) -> bool:
        """Whether a frame has points that can be followed; noise has corners, but no two images have the same."""
        corners = new_corners(frame.gray, NO_POINTS, 2 * FEW_POINTS, frame.scan.depth_m > 0)
        contrast = contrasts(frame.gray, corners)
        return int(follow(frame.gray, self._before, corners, contrast, corners, sure=False)[1].sum()) >= FEW_POINTS

    def _predicted(self, elapsed_s: float) -> Floats:
        """T_cam_key (4, 4) of the next frame at constant velocity."""
        if not 0 < self._step_s <= MAX_PREDICTED_S or not 0 < elapsed_s <= MAX_PREDICTED_S:
            return self._T_cam_key
        ratio = elapsed_s / self._step_s
        turn, move = se3.log_so3(self._step[:3, :3]), self._step[:3, 3]
        return se3.pose(se3.exp_so3(ratio * turn), ratio * move) @ self._T_cam_key

    def _guess(self, key: _Key, T_cam_key: Floats) -> Floats32:
        """Predicted pixels (n, 2) of the key's points; those without depth move like the others."""
        p_cam = se3.transform(T_cam_key, np.nan_to_num(key.p_key, nan=1.0))
        ahead = np.isfinite(key.p_key[:, 2]) & (p_cam[:, 2] > 0.1)
        guess = self._px.astype(float)
        if ahead.any():
            seen = self._camera.distort(self._camera.project(p_cam[ahead]))
            known = np.isfinite(seen).all(axis=1)
            rows = np.flatnonzero(ahead)[known]
            guess += np.median(seen[known] - guess[rows], axis=0) if len(rows) else 0.0
            guess[rows] = seen[known]
        return guess.astype(np.float32)

    def _make_key(self, frame: TrackFrame) -> None:
        """Continue the remaining points from this frame, and add new ones."""
        if not self._found:
            self._px, self._track, self._found = self._px[:0], self._track[:0], True
        allowed = frame.scan.depth_m > 0
        if frame.scan.mask is not None:
            allowed &= ~frame.scan.mask
        more = new_corners(frame.gray, self._px, self._settings.points - len(self._px), allowed)
        more = more[~_on_outline(frame.scan, more, self._depth)]
        self._px = np.concatenate([self._px, more])
        self._track = np.concatenate([self._track, self.tracks + np.arange(len(more))])
        self.tracks += len(more)
        px = self._px.astype(float)
        z_m = depth_at(frame.scan.depth_m, px, self._depth)
        p_key = self._camera.backproject(self._camera.undistort(px), z_m)
        self._key = _Key(frame, self._px, contrasts(frame.gray, self._px), p_key, len(px))
        self._T_cam_key = np.eye(4)
        self._part.set(frame.number, TrackStatus.KEYFRAME)

    def _observe(self, frame: TrackFrame, since: int = 0) -> None:
        """Write where the points of tracks from number `since` on are in a frame."""
        px, depth_m = self._px[self._track >= since].astype(float), frame.scan.depth_m
        z_m = depth_at(depth_m, px, self._depth)
        number, slope = np.full(len(px), frame.number), depth_slope(depth_m, px, z_m, self._depth)
        track = self._track[self._track >= since]
        self._part.observe(Observations(number, track, px, self._camera.undistort(px), z_m, slope))


def _on_outline(scan: Scan, px: Floats32, depth: Depth) -> Bools:
    """Whether (n,) corners (n, 2) lie at an outline, where they are not points of a surface."""
    place, radius_px = px.astype(float), np.full(len(px), OUTLINE_PX, np.float32)
    return on_outline(scan.depth_m, place, radius_px, depth_at(scan.depth_m, place, depth))
