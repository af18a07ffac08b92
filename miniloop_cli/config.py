"""The settings: typed, documented, unknown keys refused. `presets.load_settings` reads them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Literal, NamedTuple, get_args

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from miniloop_cli.feature_types import FEATURE_TYPES


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class OneOf:
    """Marks a string as one of the names in a table that may grow, where a Literal would repeat it."""

    def __init__(self, names: Iterable[str]) -> None:
        self.names = names

    def check(self, value: str) -> str:
        """The value. Raises pydantic's error for one that is not among the names."""
        if value not in self.names:
            *others, last = map(repr, self.names)
            raise PydanticCustomError("literal_error", f"Input should be {', '.join(others)} or {last}")
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return handler(schema) | {"enum": list(self.names)}


def choices(field: FieldInfo) -> tuple[Any, ...]:
    """The values that a setting may have, where it has a fixed choice; else none."""
    named = [item for item in field.metadata if isinstance(item, OneOf)]
    return tuple(named[0].names) if named else get_args(field.annotation)


class Depth(Section):
    """Which depth readings are believed."""

    min_m: float = Field(0.3, ge=0, description="Nearest depth that is used (m).")
    max_m: float = Field(8.0, gt=0, description="Farthest depth that is used (m).")
    edge_ratio: float = Field(
        0.04, gt=0, description="A feature whose four neighbouring readings differ by more than this share is dropped."
    )


class Features(Section):
    """What is detected in the colour images."""

    type: Annotated[str, OneOf(FEATURE_TYPES)] = Field("rootsift", description="Detector and descriptor.")
    count: int = Field(3000, ge=16, description="Strongest features kept in a scan.")
    contrast: float = Field(
        0.02, gt=0, description="SIFT: contrast threshold; lower finds more in dim or plain images."
    )


class Matching(Section):
    """Which features of two scans are taken for the same point."""

    ratio: float = Field(0.8, gt=0, le=1, description="Nearest over second-nearest descriptor distance, at most.")
    pairs: str = Field("auto", description="auto, exhaustive, sequential, or a file of lines 'i j' (frame numbers).")
    count: int = Field(1200, ge=16, description="Strongest features of a scan in a full comparison.")
    min_distance_consistent: int = Field(
        6, ge=0, description="auto: a pair with fewer matches that all agree in their distances is left out."
    )
    exhaustive_max_scans: int = Field(
        200, ge=2, description="auto: up to so many scans every pair is looked at; beyond, retrieval."
    )
    retrieval_k: int = Field(
        40, ge=1, description="auto, beyond exhaustive_max_scans: scans that look most alike, per scan."
    )
    sequential_window: int = Field(
        10, ge=1, description="sequential, and beyond exhaustive_max_scans: frames after each frame."
    )
    min_matches: int = Field(12, ge=3, description="T of the paper: an edge of the graph needs this many matches.")
    edge_share: float = Field(
        0.0, ge=0, le=1, description="Share of all pairs that become edges: T follows from it; 0: T is min_matches."
    )


class Ransac(Section):
    """The robust estimator of a pair and of a cycle."""

    score: Literal["msac", "count"] = Field(
        "msac",
        description="msac: truncated noise-scaled residuals; count: inliers within threshold_m, as in the paper.",
    )
    threshold_m: float = Field(0.08, gt=0, description="Inlier distance while sampling (m); loose on purpose.")
    iterations: int = Field(2000, ge=1, description="Most hypotheses an estimation.")
    confidence: float = Field(0.999, gt=0, lt=1, description="Stop when an all-inlier sample was drawn this surely.")
    adaptive: bool = Field(True, description="Stop early; off: always `iterations` hypotheses, as in the paper.")
    local_optimization: bool = Field(True, description="Gauss-Newton on all inliers of all edges of the cycle.")


class Verification(Section):
    """When an edge is believed."""

    chi2: float = Field(16.0, gt=0, description="A match is an inlier below this squared Mahalanobis distance.")
    min_inliers: int = Field(10, ge=3, description="Inliers that a verified edge needs.")
    min_share: float = Field(0.2, ge=0, le=1, description="... and their share of the matches.")
    min_weak_inliers: int = Field(6, ge=3, description="Enough for a frame that would hang on fewer than three edges.")
    guided_matching: bool = Field(
        True, description="Match pairs that failed again where averaged poses say that their scans overlap."
    )


class Cycles(Section):
    """The decomposition of the overlap graph and its joint estimation."""

    longest: Literal[2, 3, 4, 5, 6, 7] = Field(5, description="Longest cycle; 2: every edge alone (pairwise).")
    decomposition: Literal["dfs", "support"] = Field(
        "support",
        description="dfs: the paper's depth-first search; support: weak edges get strong partners, few are left over.",
    )
    loop_support: bool = Field(
        True, description="Try edges that were not verified again, in loops over edges that were; agreeing loops vouch."
    )


class Gravity(Section):
    """With `--gravity`: how far an accelerometer is believed."""

    max_median_deg: float = Field(
        6.0, gt=0, description="Gravity that contradicts the sure edges by more, at the median, is refused (degrees)."
    )
    agree_deg: float = Field(4.0, gt=0, description="An edge that agrees so well is confirmed by it (degrees).")
    max_deg: float = Field(
        8.0,
        gt=0,
        description="An edge that contradicts the vertical by more, and by 4 times that median, is dropped (degrees).",
    )
    min_bridge_inliers: int = Field(
        8,
        ge=3,
        description="In place of averaging.min_bridge_inliers for edges that gravity confirms: inliers without a loop.",
    )


class PosePrior(Section):
    """With `--pose-prior`: how far rough relative poses may be off."""

    max_deg: float = Field(20.0, gt=0, description="An edge that contradicts rough poses by more is dropped (degrees).")
    max_m: float = Field(0.5, gt=0, description="An edge that contradicts rough poses by more is dropped (m).")
    min_bridge_inliers: int = Field(
        8, ge=3, description="In place of averaging.min_bridge_inliers for edges that agree: inliers without a loop."
    )


class Averaging(Section):
    """From relative to absolute poses."""

    rotations: Literal["robust", "plain"] = Field("robust", description="L1 then IRLS; plain: without weights.")
    rotation_scale_deg: float = Field(3.0, gt=0, description="Geman-McClure scale of the IRLS (degrees).")
    translations: Literal["robust", "plain"] = Field("robust", description="Reweighted; plain: one least squares.")
    translation_scale_m: float = Field(0.03, gt=0, description="Scale of the translation reweighting (m).")
    max_residual_deg: float = Field(5.0, gt=0, description="An edge farther off than this is dropped (degrees).")
    max_residual_m: float = Field(0.10, gt=0, description="An edge farther off than this is dropped (m).")
    min_photo_consistency: float = Field(
        0.4, ge=0, lt=1, description="Share of what two scans both see that must look alike in both; 0: not checked."
    )
    min_bridge_inliers: int = Field(20, ge=0, description="Inliers that an edge needs which no loop of edges confirms.")


class Bundle(Section):
    """The joint refinement by bundle adjustment over feature tracks."""

    max_scans: int = Field(3000, ge=2, description="Of more scans only the pose graph is refined: time is bounded so.")
    partners: int = Field(15, ge=1, description="Scans that each scan is matched with again, guided by the poses.")
    radius_px: float = Field(8.0, gt=0, description="How far from its predicted place a feature is looked for (px).")
    max_distance2: float = Field(0.3, gt=0, description="Squared descriptor distance of a guided match, at most.")
    min_frames: int = Field(3, ge=2, description="Scans that a track must be seen in.")
    depth_sigma_factor: float = Field(2.0, gt=0, description="Depth noise in units of the sensor model.")
    timing: bool = Field(
        True,
        description="Estimate rolling shutter and the lag of depth behind colour from the recording, if observable.",
    )
    motion: bool = Field(
        True,
        description="With timing: estimate the motion within each frame from its own rows; off: by the path of poses.",
    )


class Cloud(Section):
    """The model that is written."""

    voxel_m: float = Field(0.01, gt=0, description="One point a voxel of this edge length (m).")
    stride_px: int = Field(4, ge=1, description="Every so manieth pixel of a scan enters the model.")


class Estimation(NamedTuple):
    """The sections that estimate and judge single edges."""

    ransac: Ransac
    verification: Verification
    cycles: Cycles


Refinement = Literal["none", "posegraph", "bundle"]


class Settings(Section):
    """All settings of `miniloop register`."""

    depth: Depth = Depth()
    features: Features = Features()
    matching: Matching = Matching()
    ransac: Ransac = Ransac()
    verification: Verification = Verification()
    cycles: Cycles = Cycles()
    gravity: Gravity = Gravity()
    pose_prior: PosePrior = PosePrior()
    averaging: Averaging = Averaging()
    refine: Refinement = Field("bundle", description="Joint refinement of all poses.")
    bundle: Bundle = Bundle()
    cloud: Cloud = Cloud()

    @property
    def estimation(self) -> Estimation:
        """What solves and judges edges."""
        return Estimation(self.ransac, self.verification, self.cycles)
