"""The verdict of an edge, and why it is rejected."""

from __future__ import annotations

from enum import IntEnum


class Verdict(IntEnum):
    """VERIFIED edges determine the poses; WEAK ones have few inliers and are used only for scans that need them."""

    VERIFIED = 0
    WEAK = 1
    REJECTED = 2

    @property
    def label(self) -> str:
        """As in edges.csv: "verified", "weak", "rejected"."""
        return self.name.lower()


class Rejection(IntEnum):
    """Why an edge is not verified. Each takes two numbers of its own, `a` and `b` (see `sentence`)."""

    NONE = 0
    FEW_INLIERS = 1  # a: inliers, b: matches
    INCONSISTENT_DISTANCES = 2  # a: matches that must agree
    NO_HYPOTHESIS = 3
    UNSUPPORTED_BRIDGE = 4  # a: inliers
    REPETITION = 5  # a: period of the pattern (m)
    DEPTH_DISCONTINUITIES = 6  # a: scan, b: share of its matches on them
    LOOKS_DIFFERENT = 7  # a: share of what both scans see that agrees
    UNCLOSED_TRIANGLES = 8
    CONTRADICTS_POSES = 9  # a: degrees, b: metres
    MOVING_COMPONENT = 10  # a: share that agrees, b: scans of the component
    SCAN_LOOKS_DIFFERENT = 11  # a: scan, b: share that agrees
    MOSTLY_MOVING = 12  # a: scans without a consistent scene
    CONTRADICTS_GRAVITY = 13  # a: degrees
    CONTRADICTS_POSE_PRIOR = 14  # a: degrees, b: metres
    JOINT_LOOKS_DIFFERENT = 15  # a: share that agrees of what two recordings, joined by it, both show

    @property
    def label(self) -> str:
        """As in edges.csv: "looks_different", ...; "" where there is none."""
        return self.name.lower() if self else ""

    def sentence(self, a: float, b: float) -> str:
        """The reason in words."""
        return _SENTENCES[self].format(a=a, b=b, a_percent=100 * a, b_percent=100 * b, b_cm=100 * b)


_SENTENCES = {
    Rejection.NONE: "",
    Rejection.FEW_INLIERS: "{a:.0f} inliers of {b:.0f} matches",
    Rejection.INCONSISTENT_DISTANCES: "no {a:.0f} matches have consistent mutual distances",
    Rejection.NO_HYPOTHESIS: "no hypothesis fits the matches",
    Rejection.UNSUPPORTED_BRIDGE: "only {a:.0f} inliers, and no loop of edges confirms it",
    Rejection.REPETITION: "both scans show a pattern that repeats every {a:.2f} m: matches may be off by one period",
    Rejection.DEPTH_DISCONTINUITIES: "scan {a:.0f}: {b_percent:.0f} % of its matches lie on depth discontinuities, "
    "which change with the viewpoint, and no overlap has enough other matches",
    Rejection.LOOKS_DIFFERENT: "only {a_percent:.0f} % of what both scans see looks the same",
    Rejection.UNCLOSED_TRIANGLES: "its loops with other edges do not close",
    Rejection.CONTRADICTS_POSES: "contradicts the other edges by {a:.1f} deg, {b_cm:.0f} cm",
    Rejection.MOVING_COMPONENT: "only {a_percent:.0f} % of what these {b:.0f} scans see more than once looks the same: "
    "something moves, or two places are confused",
    Rejection.SCAN_LOOKS_DIFFERENT: "scan {a:.0f}: only {b_percent:.0f} % of what it shares with its neighbours looks "
    "the same",
    Rejection.MOSTLY_MOVING: "{a:.0f} other scans, the majority, show no consistent scene, so this edge is not trusted",
    Rejection.CONTRADICTS_GRAVITY: "contradicts gravity by {a:.1f} deg",
    Rejection.CONTRADICTS_POSE_PRIOR: "contradicts the pose prior by {a:.0f} deg, {b:.2f} m",
    Rejection.JOINT_LOOKS_DIFFERENT: "only {a_percent:.0f} % of what both recordings show looks the same",
}
