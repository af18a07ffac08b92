"""Bundle adjustment in which parameters of the camera are free, each under its prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from miniloop_cli.geometry.camera_parameters import CameraParameters
from miniloop_cli.refinement.bundle_problem import Bundle, lost
from miniloop_cli.refinement.camera_border import Border, border, parameter_equations
from miniloop_cli.refinement.free_terms import FreeTerm
from miniloop_cli.refinement.jackknife import remaining_fraction
from miniloop_cli.typing import Floats, Ints

_TIE = 1e-8  # damping of the equations at the minimum, so that motions of the whole are not singular


class CameraProblem:
    """The problem of a bundle and of the `free` parameters (q,) of its camera, for the descent.

    `sigma` (q,): prior standard deviations of their steps from the given camera.
    """

    def __init__(
        self, bundle: Bundle, terms: Sequence[FreeTerm], parameters: CameraParameters, free: Ints, sigma: Floats
    ) -> None:
        self.bundle, self.free, self._sigma = bundle, free, sigma
        self._terms, self.parameters = list(terms), parameters
        self._set(parameters)
        state = bundle.state
        self.bundle.state = bundle.at(state.R, state.t, state.X)
        self._proposal = self.bundle.state, parameters

    @property
    def cost(self) -> float:
        """The cost of all terms and of the prior."""
        return self.bundle.state.cost + self._prior_cost(self.parameters)

    def propose(self, damping: float) -> tuple[float, float]:
        bundle, state = self.bundle, self.bundle.state
        rows = parameter_equations(self._terms, self.free, state.seen.p_cam)
        S, g, L = bundle.reduced(bundle.tracks, state.seen, damping)
        S[lost(S, len(g))] = np.eye(6)
        of_camera = border(bundle.tracks, state.seen, rows, state.R, L, damping)
        by_pose, rest = self._eliminated(S, g, of_camera)
        prior = self._sigma**-2.0
        gradient = of_camera.gradient - np.einsum("niq,ni->q", of_camera.by_pose, by_pose[:, :, 0])
        step = -np.linalg.solve(rest + np.diag(prior), gradient + prior * self.parameters.theta[self.free])
        theta = self.parameters.theta.copy()
        theta[self.free] += step
        parameters = replace(self.parameters, theta=theta)
        self._set(parameters)
        # The gradient of a point after the step of the parameters.
        felt = state.seen._replace(gradient=state.seen.gradient + rows.mixed @ step)
        moved = bundle.moved(felt, -by_pose[:, :, 0] - by_pose[:, :, 1:] @ step, L)
        self._set(self.parameters)
        self._proposal = moved, parameters
        return self.cost, moved.cost + self._prior_cost(parameters)

    def accept(self) -> None:
        self.bundle.state, self.parameters = self._proposal
        self._set(self.parameters)

    def covariance(self, part: Ints) -> Floats:
        """Covariance (q, q) of the free parameters at a minimum.

        From the grouped jackknife over the parts (k,) of the image (jackknife.py) and the uncertainty of the prior.
        """
        bundle, seen, R = self.bundle, self.bundle.state.seen, self.bundle.state.R
        rows = parameter_equations(self._terms, self.free, seen.p_cam)
        prior = self._sigma**-2.0
        S, g, L = bundle.reduced(bundle.tracks, seen, _TIE)
        S[lost(S, len(g))] = np.eye(6)
        information: Floats = self._eliminated(S, g, border(bundle.tracks, seen, rows, R, L, _TIE))[1]
        C = np.linalg.inv(information + np.diag(prior))
        pull = prior * self.parameters.theta[self.free]
        spread: Floats = np.zeros_like(C)
        for number, left in enumerate(remaining_fraction(part)):
            kept = part != number
            tracks = bundle.tracks.subset(kept)
            S, g, L = bundle.reduced(tracks, seen.subset(kept), _TIE)
            S[lost(S, len(g))] = np.eye(6)
            of_camera = border(tracks, seen.subset(kept), rows.subset(kept), R, L, _TIE)
            by_pose, without = self._eliminated(S, g, of_camera)
            gradient = of_camera.gradient - np.einsum("niq,ni->q", of_camera.by_pose, by_pose[:, :, 0])
            step = np.linalg.solve(without + np.diag(prior), gradient + pull)
            spread += left * np.outer(step, step)
        return np.asarray(C @ (prior[:, None] * C) + spread, float)

    def _eliminated(self, S: Floats, g: Floats, of_camera: Border) -> tuple[Floats, Floats]:
        """S^-1 [g | border] (n, 6, 1 + q), and the reduced Hessian (q, q) of the parameters."""
        right = np.concatenate([g[:, :, None], of_camera.by_pose], axis=2)
        by_pose = self.bundle.system.solve_columns(S, right)
        rest = of_camera.own - np.einsum("nia,nib->ab", of_camera.by_pose, by_pose[:, :, 1:], optimize=True)
        return by_pose, (rest + rest.T) / 2

    def _set(self, parameters: CameraParameters) -> None:
        self._terms = [term.at(parameters) for term in self._terms]
        self.bundle.point_terms = self._terms

    def _prior_cost(self, parameters: CameraParameters) -> float:
        return 0.5 * float(((parameters.theta[self.free] / self._sigma) ** 2).sum())
