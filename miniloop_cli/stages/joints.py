"""Stage: checks of the joints between recordings of a map; joints that the views contradict are cut."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from miniloop_cli.averaging.optimum import prove_optimum
from miniloop_cli.config import Settings
from miniloop_cli.mapping.pieces import as_one_table
from miniloop_cli.scene.certificate import Certificate
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.poses import Poses, residuals, usable_edges
from miniloop_cli.scene.scene_map import MapPart, SceneMap
from miniloop_cli.scene.verdict import Rejection
from miniloop_cli.scene.view_graph import components
from miniloop_cli.stages.join import join
from miniloop_cli.stages.keyframes import common_scans
from miniloop_cli.stages.run import Run
from miniloop_cli.typing import Ints, Pair
from miniloop_cli.verification.joints import bends, bodies_elsewhere, votes_of_joints
from miniloop_cli.verification.photometric_check import PhotometricCheck, agreement_ratio
from miniloop_cli.verification.second_best import Elsewhere

LOG = logging.getLogger("miniloop")
CUT_BELOW, DOUBTED_BELOW = 0.6, 0.75  # share of the common view of two recordings that must agree


class Evidence(NamedTuple):
    """Input of the checks: the map, body (K,) the recording of each keyframe, the keyframes of pieces of several
    recordings, and their views.
    """

    scene_map: SceneMap
    body: Ints
    joined: Ints
    photometric: PhotometricCheck

    @staticmethod
    def of(scene_map: SceneMap) -> Evidence:
        """The evidence of a map."""
        scans = common_scans(scene_map.parts)
        body = scene_map.of_part
        several = np.bincount(scene_map.joined.piece)[scene_map.joined.piece] > 1
        photometric = PhotometricCheck(scans.thumbnails, scans.points, (), (), scans.camera)
        return Evidence(scene_map, body, np.flatnonzero(several[body]), photometric)


def examined(scene_map: SceneMap, settings: Settings, run: Run) -> SceneMap:
    """The map with its doubts and its certificate, joined again without the edges that were cut."""
    evidence = Evidence.of(scene_map)
    shares = _shares_alike(evidence)
    worst = min(shares, key=lambda pair: shares[pair], default=None)
    if worst is not None and settings.averaging.min_photo_consistency > 0 and shares[worst] < CUT_BELOW:
        table = scene_map.joined.solved[worst]
        cut = table.reject(np.ones(len(table), bool), Rejection.JOINT_LOOKS_DIFFERENT, shares[worst])
        solved = {**scene_map.joined.solved, worst: cut}
        return examined(join(scene_map.parts, settings, run, solved), settings, run)
    doubts = (
        *_cuts(scene_map),
        *_alike(scene_map, shares),
        *_elsewhere(evidence, settings),
        *_bent(evidence, settings),
    )
    proof = _proof(evidence, settings)
    if proof is not None:
        LOG.info("the recordings together: %s", proof.sentence)
        if proof.escaped or not (proof.certified or proof.problem):
            doubts = (*doubts, f"the recordings together: {proof.sentence}")
    certified = proof is not None and proof.certified and not proof.escaped
    gap = proof.relative_gap if proof is not None and not proof.problem else float("inf")
    joined = replace(
        scene_map.joined, doubts=doubts, notes=_uncompared(evidence, shares), certified=certified, relative_gap=gap
    )
    return replace(scene_map, joined=joined)


def _shares_alike(evidence: Evidence) -> dict[Pair, float]:
    """The share of the common view that agrees, for each two recordings joined by edges."""
    joined, shares, edges = evidence.scene_map.joined, dict[Pair, float](), _pairs_joined(evidence)
    for piece in np.unique(joined.piece):
        inside = evidence.joined[joined.piece[evidence.body[evidence.joined]] == piece]
        if len(inside):
            votes = votes_of_joints(joined.T_world_cam, inside, evidence.body, evidence.photometric)
            shares |= {pair: float(agreement_ratio(count)) for pair, count in votes.items() if pair in edges}
    return shares


def _pairs_joined(evidence: Evidence) -> set[Pair]:
    """Pairs of recordings that edges join."""
    return {(int(a), int(b)) for a, b in np.sort(evidence.body[evidence.scene_map.joined.edges.pairs], axis=1)}


def _uncompared(evidence: Evidence, shares: dict[Pair, float]) -> tuple[str, ...]:
    """A sentence on each joint whose images were not compared."""
    parts = evidence.scene_map.parts
    return tuple(
        f"too few frames of {parts[a].name} and {parts[b].name} show the same place from similar directions to compare "
        "their images: only the edges between them show that they belong together"
        for a, b in sorted(_pairs_joined(evidence) - set(shares))
    )


def _cuts(scene_map: SceneMap) -> list[str]:
    """A sentence on each joint that was cut."""
    told = []
    for (a, b), table in scene_map.joined.solved.items():
        rows = np.flatnonzero(table.rejection == Rejection.JOINT_LOOKS_DIFFERENT)
        if len(rows):
            parts = scene_map.parts[a], scene_map.parts[b]
            told.append(
                f"{_frames(parts[0], table.i[rows])} and {_frames(parts[1], table.j[rows] - len(parts[0]))} have "
                f"{len(rows)} edges, but {table.reasons()[rows[0]]}: places were confused, and the edges are not used"
            )
    return told


def _alike(scene_map: SceneMap, shares: dict[Pair, float]) -> list[str]:
    """Doubts about joints with different views."""
    return [
        f"only {100 * share:.0f} % of what {scene_map.parts[a].name} and {scene_map.parts[b].name} both show looks "
        "alike: something was moved, or places were confused"
        for (a, b), share in shares.items()
        if share < DOUBTED_BELOW
    ]


def _elsewhere(evidence: Evidence, settings: Settings) -> list[str]:
    """Doubts about recordings that fit at another place."""
    scene_map, body = evidence.scene_map, evidence.body
    edges = as_one_table([len(part) for part in scene_map.parts], [], scene_map.joined.solved)
    same = scene_map.joined.piece[body[edges.i]] == scene_map.joined.piece[body[edges.j]]
    edges = edges.subset(edges.verified & same)
    if least := settings.averaging.min_photo_consistency:
        edges = edges.subset(agreement_ratio(evidence.photometric.votes(edges.pairs, edges.T_j_i)) >= least)
    angle_deg, distance_m = residuals(edges, scene_map.joined.T_world_cam)
    off = (angle_deg > settings.averaging.max_residual_deg) | (distance_m > settings.averaging.max_residual_m)
    here, others = edges.subset(~off), edges.subset(off)
    found = bodies_elsewhere(scene_map.joined.T_world_cam, body, here, others, settings.averaging)
    return [_moved(scene_map, body, other, edges) for other in found]


def _moved(scene_map: SceneMap, body: Ints, other: Elsewhere, edges: EdgeTable) -> str:
    """In words: the recordings that fit at another place, and the frames on both sides."""
    moved = np.isin(body[edges.pairs], other.scans)
    ends = np.unique(edges.pairs[moved[:, 0] != moved[:, 1]])
    sides = [np.isin(body[ends], other.scans), ~np.isin(body[ends], other.scans)]
    these, rest = (" and ".join(_named(scene_map, body, ends[side])) for side in sides)
    return (
        f"{these} would fit elsewhere to {rest} nearly as well, {other.angle_deg:.0f} deg and {other.distance_m:.2f} m "
        f"away: {other.matches_there} agree with that, {other.inliers_here} of "
        f"{other.pairs_here} with where it is"
    )


def _named(scene_map: SceneMap, body: Ints, keyframes: Ints) -> list[str]:
    """Recordings and frames of some keyframes of the map."""
    return [
        _frames(scene_map.parts[number], keyframes[body[keyframes] == number] - scene_map.first[number])
        for number in np.unique(body[keyframes]).tolist()
    ]


def _frames(part: MapPart, keyframes: Ints) -> str:
    """A recording, and the range of frames of these keyframes."""
    frames = part.frame[part.keyframe[np.unique(keyframes)]]
    between = f"frame {frames[0]}" if len(frames) == 1 else f"frames {frames[0]} to {frames[-1]}"
    return f"{part.name} ({between})"


def _bent(evidence: Evidence, settings: Settings) -> list[str]:
    """Doubts about recordings that are bent by the others."""
    scene_map = evidence.scene_map
    T_own = np.concatenate([part.T_world_key for part in scene_map.parts])
    found = bends(scene_map.joined.T_world_cam, T_own, evidence.body, settings.averaging)
    told = []
    for number, bend in sorted(found.items()):
        part, first = scene_map.parts[number], scene_map.first[number]
        a, b = part.frame[part.keyframe[[bend.a - first, bend.b - first]]]
        told.append(
            f"joined to the others, {part.name} is bent between frames {a} and {b} by {bend.angle_deg:.0f} deg and "
            f"{bend.distance_m:.2f} m, against how it was registered by itself"
        )
    return told


def _proof(evidence: Evidence, settings: Settings) -> Certificate | None:
    """The certificate of joined recordings, for all of their edges together; None if none are joined."""
    if not len(evidence.joined):
        return None
    scene_map, count = evidence.scene_map, len(evidence.body)
    own = as_one_table([len(part) for part in scene_map.parts], [part.edges for part in scene_map.parts], {})
    edges = EdgeTable.concatenated([own, scene_map.joined.edges])
    edges = edges.subset(np.isin(edges.i, evidence.joined) & np.isin(edges.j, evidence.joined))
    label = components(count, edges.pairs[usable_edges(edges, count)])
    alone = np.bincount(label)[label] < 2
    poses = Poses(scene_map.joined.T_world_cam, np.where(alone, -1, label))
    return prove_optimum(poses, edges, settings.averaging)[1]
