"""The settings: typed, documented, unknown keys refused. `presets.load_settings` reads them."""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from miniloop_cli.feature_types import FEATURE_TYPES
from miniloop_cli.setting_choices import OneOf


class Section(BaseModel):
    """A section of the settings; frozen, without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Depth(Section):
    """Which depth readings are used."""

    min_m: float = Field(0.3, ge=0, description="Smallest depth that is used (m).")
    max_m: float = Field(8.0, gt=0, description="Largest depth that is used (m).")
    min_confidence: int = Field(
        1,
        ge=0,
        le=2,
        description="Smallest confidence of a depth reading, if the phone records it: 0 low, 1 medium, 2 high.",
    )
    edge_ratio: float = Field(
        0.04,
        gt=0,
        description="A feature is dropped if the four depth readings around it differ by more than this share.",
    )


class Features(Section):
    """Features of the colour images."""

    type: Annotated[str, OneOf(FEATURE_TYPES)] = Field("rootsift", description="Detector and descriptor.")
    count: int = Field(3000, ge=16, description="Largest number of features of a scan. The strongest are kept.")
    contrast: float = Field(
        0.02, gt=0, description="Contrast threshold of SIFT. A lower value finds more features in dim or plain images."
    )
    first_octave: Literal["auto", -1, 0] = Field(
        "auto",
        description="First octave of SIFT. -1: the image is doubled first. 0: it is not, which takes a quarter of the "
        "time. auto: 0 for keyframes of whole recordings with images of at least 640 x 480, else -1.",
    )

    def of_keyframes(self, width: int, height: int) -> Features:
        """The settings for keyframes of whole recordings, whose images have this size in pixels.

        Tracked points determine the poses there; features only recognise known places.
        """
        if self.first_octave != "auto" or width * height < 640 * 480:
            return self
        return self.model_copy(update={"first_octave": 0})


class Tracking(Section):
    """Whole recordings: points are tracked, and only keyframes are matched."""

    enabled: Literal["auto"] | bool = Field(
        "auto", description="Follow points. auto: if frames follow each other closely. false: every frame is a scan."
    )
    points: int = Field(300, ge=50, description="Number of points that are followed from each keyframe.")
    min_followed: float = Field(
        0.4,
        gt=0,
        lt=1,
        description="A frame becomes a keyframe if less than this share of the last keyframe's points is left.",
    )


class Matching(Section):
    """Matches between features of two scans."""

    ratio: float = Field(
        0.8, gt=0, le=1, description="Ratio test: largest ratio of nearest to second-nearest descriptor distance."
    )
    pairs: str = Field(
        "auto", description="Pairs to compare: auto, exhaustive, sequential, or a file of lines 'i j' (frame numbers)."
    )
    count: int = Field(1200, ge=16, description="Number of strongest features of a scan used in a full comparison.")
    min_distance_consistent: int = Field(
        6, ge=0, description="pairs: auto. A pair is left out if fewer of its matches have consistent mutual distances."
    )
    exhaustive_max_scans: int = Field(
        200,
        ge=2,
        description="pairs: auto. Up to this number of scans all pairs are compared; above it, retrieval selects.",
    )
    retrieval_k: int = Field(
        40,
        ge=1,
        description="Above exhaustive_max_scans: each scan is compared with this number of most similar scans.",
    )
    sequential_window: int = Field(
        10,
        ge=1,
        description="Number of following frames compared with each frame (sequential, and above exhaustive_max_scans).",
    )
    min_matches: int = Field(
        12, ge=3, description="Smallest number of matches of an edge of the graph (T in the paper)."
    )
    edge_share: float = Field(
        0.0, ge=0, le=1, description="Share of all pairs that become edges; T follows from it. 0: T is min_matches."
    )


class Ransac(Section):
    """The robust estimator of a pair and of a cycle."""

    score: Literal["msac", "count"] = Field(
        "msac",
        description="msac: truncated noise-scaled residuals; count: inliers within threshold_m, as in the paper.",
    )
    threshold_m: float = Field(
        0.08, gt=0, description="Inlier distance while sampling (m). It is wide, because samples are noisy."
    )
    iterations: int = Field(2000, ge=1, description="Largest number of hypotheses for one estimation.")
    confidence: float = Field(
        0.999, gt=0, lt=1, description="Sampling stops when an all-inlier sample was drawn with this probability."
    )
    adaptive: bool = Field(True, description="Stop early. false: always `iterations` hypotheses, as in the paper.")
    local_optimization: bool = Field(
        True, description="Refine a hypothesis by Gauss-Newton on all inliers of all edges of the cycle."
    )


class Verification(Section):
    """When an edge is accepted."""

    chi2: float = Field(16.0, gt=0, description="A match is an inlier if its squared Mahalanobis distance is smaller.")
    min_inliers: int = Field(10, ge=3, description="Smallest number of inliers of a verified edge.")
    min_share: float = Field(
        0.2, ge=0, le=1, description="Smallest share of inliers among the matches of a verified edge."
    )
    min_weak_inliers: int = Field(
        6, ge=3, description="Smallest number of inliers if one of the frames has fewer than three edges."
    )
    guided_matching: bool = Field(
        True, description="Match failed pairs again if their scans overlap according to the averaged poses."
    )


class Cycles(Section):
    """The decomposition of the overlap graph and its joint estimation."""

    longest: Literal[2, 3, 4, 5, 6, 7] = Field(
        5, description="Length of the longest cycle. 2: each edge is solved alone (pairwise)."
    )
    decomposition: Literal["dfs", "support"] = Field(
        "support",
        description="dfs: the paper's depth-first search. support: weak edges share cycles with strong ones, and few "
        "edges are left out.",
    )
    loop_support: bool = Field(
        True, description="Solve unverified edges again in loops with verified ones. Loops that agree confirm an edge."
    )


class Gravity(Section):
    """With `--gravity`: how far an accelerometer is trusted."""

    max_median_deg: float = Field(
        6.0,
        gt=0,
        description="The run stops if the readings differ from verified edges by more, at the median (degrees).",
    )
    agree_deg: float = Field(4.0, gt=0, description="An edge that agrees within this angle is confirmed (degrees).")
    max_deg: float = Field(
        8.0,
        gt=0,
        description="An edge is dropped if it differs from the vertical by more, and by 4 times the median (degrees).",
    )
    min_bridge_inliers: int = Field(
        8,
        ge=3,
        description="Replaces averaging.min_bridge_inliers for edges that gravity confirms.",
    )


class PosePrior(Section):
    """With `--pose-prior`: the largest errors of rough relative poses."""

    max_deg: float = Field(
        20.0, gt=0, description="An edge is dropped if it differs from the rough poses by more (degrees)."
    )
    max_m: float = Field(0.5, gt=0, description="An edge is dropped if it differs from the rough poses by more (m).")
    min_bridge_inliers: int = Field(
        8, ge=3, description="Replaces averaging.min_bridge_inliers for edges that agree with the rough poses."
    )


class Averaging(Section):
    """From relative to absolute poses."""

    rotations: Literal["robust", "plain"] = Field(
        "robust", description="robust: L1, then reweighted least squares (IRLS). plain: one unweighted solution."
    )
    rotation_scale_deg: float = Field(3.0, gt=0, description="Geman-McClure scale of the IRLS (degrees).")
    translations: Literal["robust", "plain"] = Field(
        "robust", description="robust: reweighted least squares. plain: one least-squares solution."
    )
    translation_scale_m: float = Field(0.03, gt=0, description="Cauchy scale of the reweighted translations (m).")
    max_residual_deg: float = Field(5.0, gt=0, description="An edge with a larger residual is dropped (degrees).")
    max_residual_m: float = Field(0.10, gt=0, description="An edge with a larger residual is dropped (m).")
    min_photo_consistency: float = Field(
        0.4,
        ge=0,
        lt=1,
        description="Smallest share of the common view of two scans that must look alike. 0: not checked.",
    )
    min_bridge_inliers: int = Field(
        20, ge=0, description="Smallest number of inliers of an edge that no loop of edges confirms."
    )


class Bundle(Section):
    """The joint refinement by bundle adjustment over feature tracks."""

    max_scans: int = Field(
        3000, ge=2, description="With more scans only the pose graph is refined, which saves time and memory."
    )
    partners: int = Field(
        15,
        ge=1,
        description="Each scan is matched again with the N of most matches, and the N that share most of its view.",
    )
    radius_px: float = Field(8.0, gt=0, description="Search radius around a feature's predicted position (px).")
    max_distance2: float = Field(0.3, gt=0, description="Largest squared descriptor distance of a guided match.")
    min_frames: int = Field(3, ge=2, description="Smallest number of scans in a track.")
    followed_per_frame: int = Field(
        120, ge=12, description="Whole recordings: smallest number of followed points of each frame in the adjustment."
    )
    depth_sigma_factor: float = Field(2.0, gt=0, description="Depth noise as a multiple of the sensor model.")
    timing: bool = Field(
        True,
        description="Estimate rolling shutter and the lag of depth behind colour, if the recording determines them.",
    )
    motion: bool = Field(
        True,
        description="With timing: estimate the motion within each frame from its rows. false: from the path of poses.",
    )


class Cloud(Section):
    """The model that is written."""

    voxel_m: float = Field(0.01, gt=0, description="Voxel size (m). Each voxel holds one point.")
    stride_px: int = Field(4, ge=1, description="Pixel stride: every N-th pixel of a scan is used (px).")


class Estimation(NamedTuple):
    """The sections that estimate and judge single edges."""

    ransac: Ransac
    verification: Verification
    cycles: Cycles


Refinement = Literal["none", "posegraph", "bundle"]
Calibrate = Literal["off", "auto", "on"]
_ON_OFF = BeforeValidator(
    lambda value: ("on" if value else "off") if isinstance(value, bool) else value
)  # YAML 1.1 reads on and off as booleans


class Settings(Section):
    """All settings of `miniloop register`."""

    depth: Depth = Depth()
    features: Features = Features()
    tracking: Tracking = Tracking()
    matching: Matching = Matching()
    ransac: Ransac = Ransac()
    verification: Verification = Verification()
    cycles: Cycles = Cycles()
    gravity: Gravity = Gravity()
    pose_prior: PosePrior = PosePrior()
    averaging: Averaging = Averaging()
    refine: Refinement = Field(
        "bundle", description="Joint refinement of all poses: bundle adjustment, pose graph, or none."
    )
    bundle: Bundle = Bundle()
    calibrate: Annotated[Calibrate, _ON_OFF] = Field(
        "auto",
        description="With refine: bundle, estimate the camera from the recording. auto: if the camera is a guess.",
    )
    cloud: Cloud = Cloud()

    @property
    def estimation(self) -> Estimation:
        """The sections that estimate and judge edges."""
        return Estimation(self.ransac, self.verification, self.cycles)
