"""The camera parameters that a recording determined."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from miniloop_cli.geometry import depth_model
from miniloop_cli.geometry.camera import Camera, Trust
from miniloop_cli.geometry.camera_parameters import DISTORTION, NAMES, OF_ONE_CAMERA, CameraParameters
from miniloop_cli.geometry.depth_camera_parameters import NAMES as TWO
from miniloop_cli.geometry.depth_camera_parameters import steps_between
from miniloop_cli.scene.sequence import DepthCamera
from miniloop_cli.typing import Floats, Ints


class Status(IntEnum):
    """The outcome for a parameter."""

    ESTIMATED = 0
    UNOBSERVABLE = 1  # the recording does not determine it: it keeps its value
    NO_GAIN = 2  # held-out points are not predicted better with it: it keeps its value


class Value(NamedTuple):
    """A value of the camera: as given, as it is now, its standard deviation, its status."""

    name: str
    given: float
    value: float
    sigma: float
    status: Status


@dataclass(frozen=True)
class Calibration:
    """Parameters `theta` relative to the given camera, their covariance and the status of each.

    theta (p,), covariance (p, p; the prior for parameters that keep their value), status (p,) numbers of Status, by
    camera_parameters.NAMES. `gain`: relative decrease of the cost of held-out points, and `gain_sigma` its standard
    deviation. `scale_sigma`: relative, of the unit of depth, which a recording does not determine. `depth_given`: the
    given separate depth camera, if it was calibrated. `beforehand`: from an earlier run, so that the features are
    those of the calibrated camera. `sigma_factor`: by which the covariance of estimated parameters was enlarged
    (standard deviations; it is in the covariance), as two halves of the recording disagree beyond it.
    """

    given: Camera
    theta: Floats
    covariance: Floats
    status: Ints
    middle_m: float
    gain: float
    gain_sigma: float
    scale_sigma: float
    depth_given: DepthCamera | None = None
    beforehand: bool = False
    sigma_factor: float = 1.0

    @property
    def depth_camera(self) -> DepthCamera | None:
        """The calibrated depth camera, if it is separate."""
        if self.depth_given is None:
            return None
        found = self.depth_given.moved(self.parameters.of_depth_camera)
        return replace(found, camera=replace(found.camera, trust=Trust.CALIBRATED))

    @property
    def parameters(self) -> CameraParameters:
        """The steps from the given camera."""
        return CameraParameters(self.given, self.theta, self.middle_m)

    @property
    def camera(self) -> Camera:
        """The calibrated camera."""
        source = f"estimated from the recording, beginning with {self.given.source}"
        return replace(self.parameters.camera, source=source, trust=Trust.CALIBRATED)

    @property
    def changed(self) -> bool:
        """Whether anything was estimated."""
        return bool((self.status == Status.ESTIMATED).any())

    @property
    def as_given(self) -> tuple[Camera, DepthCamera | None]:
        """The calibrated cameras, trusted as the given ones are: where another fit begins."""
        own, given = self.depth_camera, self.depth_given
        if own and given:
            own = replace(own, camera=replace(own.camera, trust=given.camera.trust))
        return replace(self.camera, trust=self.given.trust), own

    def continues(self, first: Calibration) -> Calibration:
        """This calibration relative to what `first` was given, if it began with the cameras that `first` estimated.

        The model, and what it gains, are those of `first`.
        """
        of_depth = np.zeros(len(TWO))
        if first.depth_given and (own := self.depth_camera):
            given = first.depth_given
            of_depth = steps_between((given.camera, given.T_color_depth), (own.camera, own.T_color_depth))
        theta = CameraParameters.between(first.given, self.camera, of_depth, self.middle_m).theta
        found = replace(first, theta=theta, covariance=self.covariance, middle_m=self.middle_m)
        return replace(found, sigma_factor=self.sigma_factor)

    @property
    def sigmas(self) -> Floats:
        """(p,) standard deviations."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def names_estimated(self) -> tuple[str, ...]:
        """Parameters that were estimated, by camera_parameters.NAMES; focal: relative (log), aspect: of fy / fx."""
        return tuple(name for name, status in zip(NAMES, self.status, strict=True) if status == Status.ESTIMATED)

    @property
    def covariance_estimated(self) -> Floats:
        """Their covariance, row by row."""
        rows = np.flatnonzero(self.status == Status.ESTIMATED)
        return self.covariance[np.ix_(rows, rows)]

    def values(self) -> list[Value]:
        """Every number in its own unit, in the order of NAMES, fx and fy in place of focal and aspect."""
        camera, C = self.camera, self.covariance
        of_fy = float(np.sqrt(max(C[0, 0] + 2 * C[0, 1] + C[1, 1], 0.0)))
        status = [Status(int(number)) for number in self.status]
        found = [
            Value("fx", self.given.fx, camera.fx, camera.fx * float(self.sigmas[0]), status[0]),
            Value("fy", self.given.fy, camera.fy, camera.fy * of_fy, status[0]),
            Value("cx", self.given.cx, camera.cx, float(self.sigmas[2]), status[2]),
            Value("cy", self.given.cy, camera.cy, float(self.sigmas[3]), status[3]),
        ]
        lens, bent = self.given.lens.named, camera.lens.named
        depth = zip(
            depth_model.NAMES, self.given.depth_model.coefficients, camera.depth_model.coefficients, strict=True
        )
        rows = [(name, lens.get(name, 0.0), bent.get(name, 0.0)) for name in DISTORTION]
        rows += [(f"depth_{name}", before, after) for name, before, after in depth]
        for k, (name, before, after) in enumerate(rows, start=4):
            found.append(Value(name, before, after, float(self.sigmas[k]), status[k]))
        return found + self._of_depth_camera(status)

    def _of_depth_camera(self, status: list[Status]) -> list[Value]:
        """Values of the depth camera: px, degrees and m; rotations and shifts are relative to the given pose."""
        if self.depth_given is None or (own := self.depth_camera) is None:
            return []
        given, now, sigma, step = self.depth_given.camera, own.camera, self.sigmas, self.parameters.of_depth_camera
        k = OF_ONE_CAMERA
        found = [
            Value("depth_fx", given.fx, now.fx, now.fx * float(sigma[k]), status[k]),
            Value("depth_cx", given.cx, now.cx, float(sigma[k + 1]), status[k + 1]),
            Value("depth_cy", given.cy, now.cy, float(sigma[k + 2]), status[k + 2]),
        ]
        for j, name in enumerate(TWO[3:], start=3):
            unit, word = (np.degrees(1), "deg") if name.startswith("turn") else (1.0, "m")
            size, unsure = float(unit * step[j]), float(unit * sigma[k + j])
            found.append(Value(f"depth_{name}_{word}", 0.0, size, unsure, status[k + j]))
        return found
