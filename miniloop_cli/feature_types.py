"""The feature types by name: detector, exact position, and comparison of descriptors.

A new type is one entry of FEATURE_TYPES, which the settings, the command line and the stages use. The module is below
the settings, which are checked against it, and without heavy imports, as the command line lists its names.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from miniloop_cli.typing import Bytes, Floats, Floats32


class Keypoints(NamedTuple):
    """The keypoints of one image, in any order.

    px: (n, 2) float64 pixels, centres at integers; radius_px: (n,) float32 of the blob or corner;
    response: (n,) float32, larger is better; descriptors: (n, d) as stored.
    """

    px: Floats
    radius_px: Floats32
    response: Floats32
    descriptors: NDArray[Any]


Detector = Callable[["Bytes", int, float], Keypoints]  # grey image (h, w), features wanted, setting `contrast`


@dataclass(frozen=True)
class Descriptors:
    """How descriptors (n, d) are stored and compared.

    binary: they are bits, compared by Hamming distance; else real numbers, by Euclidean distance.
    dtype: as stored, uint8 or float32 (small ones are kept as bytes).
    comparable: from stored ones to those for `features.match`: uint8 bits, or float32.
    compact: from stored ones to small integers (n, d) uint8, for guided matching and sketches, and the scale of their
    squared distances. After division by it, distances of unrelated features are about 1 to 2 and those of the same
    point mostly below 0.3, for every type.
    """

    binary: bool
    dtype: str
    comparable: Callable[[NDArray[Any]], NDArray[Any]]
    compact: Callable[[NDArray[Any]], tuple[Bytes, float]]


@dataclass(frozen=True)
class FeatureType:
    """A detector with its descriptor. It must be deterministic: the same image, the same bytes.

    blob: its keypoints are extrema of a Laplacian at their scale, which a slanted surface shifts from the middle
    (`features.keypoints3d.blob_shift`).
    version: raise it when the keypoints change, so that older cached features are not used.
    """

    detector: Detector
    descriptors: Descriptors
    blob: bool = False
    version: int = 1


def opencv(create: Callable[[int, float], Any], radius: float = 0.5, shift_px: float = 0.0) -> Detector:
    """A detector from `create(count, contrast)`, which makes one of OpenCV's.

    radius: the radius of a feature as a share of OpenCV's `size`; shift_px: by which OpenCV places every feature too
    far right and down.
    """

    def find(gray: Bytes, count: int, contrast: float) -> Keypoints:
        import numpy as np

        keypoints, descriptors = create(count, contrast).detectAndCompute(gray, None)
        return Keypoints(
            np.array([k.pt for k in keypoints], float).reshape(-1, 2) - shift_px,
            np.array([k.size for k in keypoints], np.float32) * np.float32(radius),
            np.array([k.response for k in keypoints], np.float32),
            np.zeros((0, 64)) if descriptors is None else descriptors,
        )

    return find


def opencv_function(name: str) -> Callable[..., Any]:
    """A function of OpenCV's main module, or of the contributed one, to which OpenCV 5 moved some detectors."""
    import cv2

    return getattr(cv2, name, None) or getattr(cv2.xfeatures2d, name)


def _surf(gray: Bytes, count: int, contrast: float) -> Keypoints:
    """SURF by OpenCV if its build includes it, else by mahotas."""
    if _opencv_has_surf():
        return opencv(lambda *_: opencv_function("SURF_create")(hessianThreshold=100))(gray, count, contrast)
    import numpy as np
    from mahotas.features import surf

    # Columns: y, x, scale, score, laplacian, angle, then 64 descriptor values.
    found = surf.surf(gray, nr_octaves=4, nr_scales=6, initial_step_size=1, threshold=0.1, max_points=count)
    return Keypoints(
        found[:, [1, 0]].astype(float),
        2 * found[:, 2].astype(np.float32),
        found[:, 3].astype(np.float32),
        found[:, 6:].astype(np.float32),
    )


@cache
def _opencv_has_surf() -> bool:
    # The symbol exists in every build, but raises without the non-free modules.
    import cv2

    try:
        opencv_function("SURF_create")()
    except (AttributeError, cv2.error):
        return False
    return True


def _as_they_are(stored: NDArray[Any]) -> NDArray[Any]:
    return stored


def _as_real(stored: NDArray[Any]) -> NDArray[Any]:
    return stored.astype("float32")


def _hellinger(stored: NDArray[Any]) -> NDArray[Any]:
    """Square roots of the L1-normalised histograms (n, d): SIFT under the Hellinger kernel."""
    import numpy as np

    real = _as_real(stored)
    return np.sqrt(real / np.maximum(real.sum(axis=1, keepdims=True), 1))


def _compact_bits(stored: NDArray[Any]) -> tuple[Bytes, float]:
    import numpy as np

    bits = np.unpackbits(stored, axis=1)
    return bits, 2 * bits.shape[1] / 3


def _compact_hellinger(stored: NDArray[Any]) -> tuple[Bytes, float]:
    import numpy as np

    return np.rint(255 * _hellinger(stored)).astype(np.uint8), 255.0**2


def _compact_histograms(stored: NDArray[Any]) -> tuple[Bytes, float]:
    return stored, 512.0**2  # the norm that OpenCV gives SIFT's histograms


def _compact_unit(stored: NDArray[Any]) -> tuple[Bytes, float]:
    import numpy as np

    return np.clip(np.rint(127 * stored) + 128, 0, 255).astype(np.uint8), 127.0**2


BITS = Descriptors(True, "uint8", _as_they_are, _compact_bits)
UNIT_VECTORS = Descriptors(False, "float32", _as_they_are, _compact_unit)  # of values of both signs
HISTOGRAMS = Descriptors(False, "uint8", _as_real, _compact_histograms)
ROOT_HISTOGRAMS = Descriptors(False, "uint8", _hellinger, _compact_hellinger)

# A keypoint's size is two sigma of SIFT's Gaussian. SIFT doubles the image first and places every feature 0.25 px too
# far right and down; OpenCV's own correction, enable_precise_upscale, finds fewer features.
SIFT = opencv(
    lambda count, contrast: opencv_function("SIFT_create")(nfeatures=count, contrastThreshold=contrast), 1.0, 0.25
)
FEATURE_TYPES = {
    "rootsift": FeatureType(SIFT, ROOT_HISTOGRAMS, blob=True),  # Arandjelović & Zisserman, CVPR 2012
    "sift": FeatureType(SIFT, HISTOGRAMS, blob=True),
    # The size of ORB and BRISK is that of the described patch; the feature is a FAST or AGAST corner in its middle.
    "orb": FeatureType(
        opencv(lambda count, _: opencv_function("ORB_create")(nfeatures=count, fastThreshold=10), 3.5 / 31), BITS
    ),
    "surf": FeatureType(_surf, UNIT_VECTORS),
    "akaze": FeatureType(opencv(lambda *_: opencv_function("AKAZE_create")(threshold=5e-4)), BITS),
    "brisk": FeatureType(opencv(lambda *_: opencv_function("BRISK_create")(thresh=20), 3.5 / 12), BITS),
}
