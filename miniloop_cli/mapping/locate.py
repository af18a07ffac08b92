"""The pose of an image in a map: similar keyframes, matches, absolute pose, and its checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from miniloop_cli.config import Bundle
from miniloop_cli.feature_types import FEATURE_TYPES
from miniloop_cli.features.detect import compact
from miniloop_cli.features.guided import guided_match, searchable
from miniloop_cli.features.lsh_match import MAX_FEATURES, Sketcher, match_sketched
from miniloop_cli.features.retrieval import described
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.graph.visibility import shared_with_view
from miniloop_cli.mapping.absolute_pose import PoseEstimate, Sightings, refined_pose, robust_pose
from miniloop_cli.mapping.common_camera import features_in, pinhole, view_in
from miniloop_cli.mapping.location import Location, doubts_about, lost, unknown_motion
from miniloop_cli.mapping.query import Query
from miniloop_cli.mapping.retrieval import most_similar, small
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.points import scan_points
from miniloop_cli.scene.scene_map import SceneMap
from miniloop_cli.scene.thumbnail import View
from miniloop_cli.typing import Bools, Floats, Ints
from miniloop_cli.verification.photometric import compare_views
from miniloop_cli.verification.photometric_check import agreement_ratio

CANDIDATES = 10  # keyframes that an image is compared with
NEAREST, MIN_SHARED = 6, 0.2  # keyframes that it is then matched with again, and their smallest overlap with it
MIN_MATCHES = 8  # with a keyframe, to take part
THRESHOLD_PX = 8.0  # while sampling: points have errors of millimetres, and rolling shutters deform images
MIN_INLIERS, MIN_SHARE = 12, 0.1  # of the matches; at a wrong pose up to a twelfth of some 200 agree by chance
MIN_ALIKE = 0.4  # share of the common view that must agree
RATIO = 0.8  # of the distances of the nearest and the second nearest descriptor
RIVAL = 0.5  # share of the inliers with which another pose makes this one doubtful
OTHER_DEG, OTHER_M = 5.0, 0.1  # smallest difference to another pose
FOCAL_STEPS = (1.0, 0.85, 1.18, 0.72, 1.39)  # factors that are tried if the focal length is a guess


@dataclass(frozen=True)
class Locator:
    """A map prepared to locate many images."""

    scene_map: SceneMap
    common: Camera
    features: Sequence[ScanFeatures]  # of all keyframes, in the common camera
    views: Sequence[View | None]
    piece: Ints  # of each keyframe
    sample: Floats  # (K, s, 3) points of each keyframe in the world
    sketcher: Sketcher
    _ready: dict = field(default_factory=dict, repr=False)
    _sketched: dict = field(default_factory=dict, repr=False)

    @staticmethod
    def of(scene_map: SceneMap) -> Locator:
        """The locator of a map."""
        common = pinhole(scene_map.parts[0].camera)
        features = [features_in(f, part.camera, common) for part in scene_map.parts for f in part.features]
        views = [view_in(view, part.camera, common) for part in scene_map.parts for view in part.views]
        piece = scene_map.joined.piece[scene_map.of_part]
        sample = np.full((len(features), 60, 3), np.nan)
        for k, (scan, T) in enumerate(zip(features, scene_map.joined.T_world_cam, strict=True)):
            if len(scan):
                rows = np.linspace(0, len(scan) - 1, 60).astype(int)
                sample[k] = se3.transform(T, common.backproject(scan.px_ideal[rows], scan.z_m[rows]))
        kind = scene_map.feature_type
        sketcher = Sketcher.of([compact(f.descriptors[:200], kind)[0] for f in features])
        return Locator(scene_map, common, features, views, piece, sample, sketcher)

    def locate(self, query: Query) -> Location:
        """The location of an image."""
        if len(query.features) < MIN_MATCHES:
            return lost(f"the image has {len(query.features)} features")
        kind = self.scene_map.feature_type
        retrieval = self.scene_map.joined.retrieval
        vector = described([small(query.features.descriptors, kind)], retrieval.words)[0]
        found = self._matches(query, most_similar(retrieval.vectors, vector, CANDIDATES))
        if not found:
            return lost(f"no keyframe has {MIN_MATCHES} matches with the image")
        poses = [self._pose(query, found, int(piece)) for piece in np.unique([self.piece[k] for k in found])]
        best = max((pose for pose in poses if pose), key=lambda pose: pose.inliers.sum(), default=None)
        if best is None:
            return lost("its matches agree on no pose")
        return best.judged(self, query)

    def _matches(self, query: Query, keyframes: Ints) -> dict[int, Ints]:
        """Matches (k, 2) of the image with each keyframe that has enough."""
        kind = self.scene_map.feature_type
        ratio2 = RATIO ** (1 if FEATURE_TYPES[kind].descriptors.binary else 2)
        own, found = self.sketcher.sketched(compact(query.features.descriptors, kind)[0]), {}
        for k in keyframes.tolist():
            if k not in self._sketched:
                self._sketched[k] = self.sketcher.sketched(compact(self.features[k].descriptors, kind)[0])
            rows = match_sketched(own, self._sketched[k], MAX_FEATURES, ratio2)
            if len(rows) >= MIN_MATCHES:
                found[k] = rows
        return found

    def _pose(self, query: Query, found: dict[int, Ints], piece: int) -> _Candidate | None:
        """The pose that most matches with one piece agree on, refined with guided matches."""
        found = {k: rows for k, rows in found.items() if self.piece[k] == piece}
        best: tuple[Floats, int] | None = None
        focal = 1.0
        for factor in FOCAL_STEPS if query.rough else (1.0,):
            seen, _ = self.sightings(query, found, factor)
            robust = robust_pose(seen, self.common, THRESHOLD_PX)
            count = int(robust[1].sum()) if robust else 0
            if robust and count >= max(MIN_INLIERS, MIN_SHARE * len(seen)) and (best is None or count > best[1]):
                best, focal = (robust[0], count), factor
        if best is None:
            return None
        T = best[0]
        seen, _ = self.sightings(query, found, focal)
        for _ in range(2):
            fit = refined_pose(T, seen, self.common, with_focal=query.rough)
            focal, T = focal * fit.focal, fit.T_world_cam
            guided = self._guided(query, T, piece, focal)
            if not guided:
                return None
            seen, of_keyframe = self.sightings(query, guided, focal)
        fit = refined_pose(T, seen, self.common, with_focal=query.rough)
        return _Candidate(fit, seen, of_keyframe, piece, focal * fit.focal, found)

    def _guided(self, query: Query, T_world_cam: Floats, piece: int, focal: float) -> dict[int, Ints]:
        """Matches (k, 2) with the keyframes that overlap most with this view, near their predicted positions."""
        bundle, kind = Bundle(), self.scene_map.feature_type
        features = self.query_features(query, focal)
        own, scale = compact(features.descriptors, kind)
        ready, found = searchable(features, own, self.common), {}
        for k in self.near(T_world_cam, piece).tolist():
            if k not in self._ready:
                self._ready[k] = searchable(
                    self.features[k], compact(self.features[k].descriptors, kind)[0], self.common
                )
            T_key_cam = se3.inverse(self.scene_map.joined.T_world_cam[k]) @ T_world_cam
            rows = guided_match(
                ready, self._ready[k], T_key_cam, self.common, bundle.radius_px, bundle.max_distance2 * scale
            )
            if len(rows):
                found[k] = rows
        return found

    def near(self, T_world_cam: Floats, piece: int) -> Ints:
        """Numbers (k,) of the keyframes of a piece that overlap most with the view from T_world_cam (4, 4)."""
        share = np.where(self.piece == piece, shared_with_view(T_world_cam, self.sample, self.common), 0.0)
        best = np.argsort(-share, kind="stable")[:NEAREST]
        return best[share[best] > MIN_SHARED]

    def query_features(self, query: Query, focal: float) -> ScanFeatures:
        """The image's features in the common camera, its focal length times a factor."""
        return features_in(query.features, _with_focal(query.camera, focal), self.common)

    def sightings(self, query: Query, found: dict[int, Ints], focal: float) -> tuple[Sightings, Ints]:
        """The observations from the matches, each feature once, and the keyframe (k,) of each.

        A feature with matches in several keyframes uses the point with the smallest uncertainty.
        """
        features, joined = self.query_features(query, focal), self.scene_map.joined
        first, marks = self.scene_map.first_feature, joined.landmarks
        own, points, covariances, keyframe = [], [], [], []
        for k, rows in found.items():
            T, other = joined.T_world_cam[k], rows[:, 1]
            scan = self.features[k]
            p = scan_points(replace(scan, px_ideal=scan.px_ideal[other], z_m=scan.z_m[other]), self.common)
            number = marks.of_feature[first[k] + other]
            known = number >= 0
            C = T[:3, :3] @ p.covariances_m2 @ T[:3, :3].T
            p_world = se3.transform(T, p.points_m)
            p_world[known], C[known] = marks.points_m[number[known]], marks.covariances_m2[number[known]]
            own.append(rows[:, 0])
            points.append(p_world)
            covariances.append(C)
            keyframe.append(np.full(len(rows), k))
        of, p_all, C_all, of_key = (np.concatenate(part) for part in (own, points, covariances, keyframe))
        order = np.lexsort((np.trace(C_all, axis1=1, axis2=2), of))
        once = order[np.unique(of[order], return_index=True)[1]]
        of = of[once]
        return Sightings(features.px_ideal[of], features.z_m[of], p_all[once], C_all[once]), of_key[once]


@dataclass(frozen=True)
class _Candidate:
    """A pose, the observations of its refinement and their keyframes (k,)."""

    fit: PoseEstimate
    seen: Sightings
    of_keyframe: Ints
    piece: int
    focal: float
    found: dict[int, Ints]

    @property
    def inliers(self) -> Bools:
        """Which observations agree (k,)."""
        return self.fit.inliers

    def judged(self, locator: Locator, query: Query) -> Location:
        """The location with the doubts about the pose."""
        count = int(self.inliers.sum())
        if count < MIN_INLIERS:
            return lost(f"{count} of {len(self.seen)} matches agree on a pose, {MIN_INLIERS} are needed", count)
        votes = self._votes(locator, query)
        alike = float(agreement_ratio(votes))
        if alike < MIN_ALIKE:
            return lost(f"{count} matches agree on a pose, but what is seen from there looks different", count)
        covariance = self.fit.covariance + unknown_motion(query.timing, query.with_depth)
        doubts = doubts_about(self.seen.px_ideal[self.inliers], len(self.seen), alike, covariance, locator.common)
        if self._has_rival(locator, query, count):
            doubts.append("another place of the map fits nearly as well")
        keyframes, times = np.unique(self.of_keyframe[self.inliers], return_counts=True)
        saw = tuple(int(k) for k in keyframes[np.argsort(-times, kind="stable")])
        focal_px = query.camera.fx * self.focal if query.rough else None
        return Location(
            True, not doubts, "; ".join(doubts), self.fit.T_world_cam, covariance, count, saw, self.piece,
            focal_px,
        )  # fmt: skip

    def _votes(self, locator: Locator, query: Query) -> Ints:
        """(2,) numbers of cells of the views for and against the pose."""
        own = view_in(query.view, _with_focal(query.camera, self.focal), locator.common)
        keyframes = [k for k in locator.near(self.fit.T_world_cam, self.piece).tolist() if locator.views[k] is not None]
        if own is None or not keyframes:
            return np.zeros(2, np.int64)
        T_cam_key = se3.inverse(self.fit.T_world_cam) @ locator.scene_map.joined.T_world_cam[keyframes]
        votes = compare_views(((locator.views[k], own) for k in keyframes), T_cam_key, locator.common)
        return np.array(votes, np.int64).sum(axis=0)

    def _has_rival(self, locator: Locator, query: Query, count: int) -> bool:
        """Whether the outliers of the pose agree on another one."""
        seen, _ = locator.sightings(query, self.found, self.focal)
        T_cam_world = se3.inverse(self.fit.T_world_cam)
        p = se3.transform(T_cam_world, seen.points_m)
        p[:, 2] = np.where(p[:, 2] > 0, p[:, 2], np.nan)
        off = np.linalg.norm(locator.common.project(p) - seen.px_ideal, axis=1)
        others = seen.subset(~(off < 2 * THRESHOLD_PX))
        rival = robust_pose(others, locator.common, THRESHOLD_PX)
        if rival is None or rival[1].sum() < max(RIVAL * (len(seen) - len(others)), MIN_INLIERS):
            return False
        E = T_cam_world @ rival[0]
        return bool(se3.rotation_angle_deg(E[:3, :3]) > OTHER_DEG or np.linalg.norm(E[:3, 3]) > OTHER_M)


def _with_focal(camera: Camera, factor: float) -> Camera:
    return replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)
