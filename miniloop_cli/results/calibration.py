"""The estimated camera of a run, for summary.json, camera.yaml, the terminal and the report."""

from __future__ import annotations

from typing import Any

from miniloop_cli.scene.calibration import Calibration, Status

LARGE_FACTOR = 2.0  # of standard deviations; a larger one is said in words
DIGITS = dict.fromkeys(("fx", "fy", "cx", "cy", "depth_fx", "depth_cx", "depth_cy"), 2)
WORDS = {
    Status.ESTIMATED: "estimated",
    Status.UNOBSERVABLE: "not observable",
    Status.NO_GAIN: "no gain",
}


def numbers(found: Calibration) -> dict[str, Any]:
    """For summary.json: whether the camera changed, and each value as given, as estimated, and its sigma."""
    return {
        "changed": found.changed,
        "held_out_gain": round(found.gain, 5),
        "held_out_gain_sigma": round(min(found.gain_sigma, 1e9), 5),
        "depth_scale_sigma": found.scale_sigma,
        "sigma_factor": round(found.sigma_factor, 3),
        "parameters": {
            each.name: {
                "given": _rounded(each.given),
                "value": _rounded(each.value),
                "sigma": _rounded(each.sigma),
                "status": WORDS[each.status],
            }
            for each in found.values()
        },
    }


def uncertainty(found: Calibration) -> dict[str, Any]:
    """For camera.yaml: standard deviations, and the covariance of the estimated values with the names of its rows."""
    return {
        "sigma": {each.name: _rounded(each.sigma) for each in found.values()} | {"depth_scale": _scale(found)},
        "covariance_of": list(found.names_estimated),
        "covariance": [[_rounded(float(value)) for value in row] for row in found.covariance_estimated],
    }


def one_line(numbers: dict[str, Any]) -> str:
    """For the terminal: estimated and unchanged values, from the numbers of summary.json."""
    if not numbers["changed"]:
        return "unchanged: no other camera predicts held-out points clearly better than the one given"
    by_status: dict[str, list[str]] = {}
    for name, each in numbers["parameters"].items():
        by_status.setdefault(each["status"], []).append(_words(name, each))
    parts = [", ".join(by_status.pop(WORDS[Status.ESTIMATED], []))]
    parts += [f"{status}: {', '.join(word.split()[0] for word in words)}" for status, words in by_status.items()]
    gain = 100 * numbers["held_out_gain"]
    ends = [f"held-out points fit {gain:.1f} % better", "the unit of depth is not estimated"]
    return "; ".join([*parts, *ends, *_disagreement(numbers)])


def in_words(numbers: dict[str, Any]) -> str:
    """Whether the camera changed, what that gains, and what cannot be estimated."""
    if not numbers["changed"]:
        return "The camera is unchanged: no other one predicts held-out points clearly better than the one given."
    gain, sigma = 100 * numbers["held_out_gain"], 100 * numbers["held_out_gain_sigma"]
    said = (
        f"Held-out points fit {gain:.1f} ± {sigma:.1f} % better. The unit of depth stays that of the sensor, known to "
        f"{100 * numbers['depth_scale_sigma']:g} %: a recording does not determine it."
    )
    return " ".join([said, *(f"{each[0].upper()}{each[1:]}." for each in _disagreement(numbers))])


def rows(numbers: dict[str, Any]) -> list[tuple[str, str, str, str, str]]:
    """For the report: name, given value, present value, standard deviation, status."""
    return [
        (name, f"{each['given']:.6g}", f"{each['value']:.6g}", f"{each['sigma']:.2g}", each["status"])
        for name, each in numbers["parameters"].items()
    ]


def _disagreement(numbers: dict[str, Any]) -> list[str]:
    """A clause, if two halves of the recording determine clearly different cameras."""
    factor = numbers.get("sigma_factor", 1.0)  # results of earlier versions have none
    if factor <= LARGE_FACTOR:
        return []
    text = f"the two halves of the recording determine different cameras: standard deviations are {factor:.1f} times"
    return [f"{text} larger than within a half"]


def _words(name: str, each: dict[str, Any]) -> str:
    digits = DIGITS.get(name, 4)
    return f"{name} {each['value']:.{digits}f} ± {each['sigma']:.{digits}f}"


def _scale(found: Calibration) -> float:
    return _rounded(found.scale_sigma * found.given.depth_scale)


def _rounded(value: float) -> float:
    """To seven digits, as further ones depend on how the kernels were compiled."""
    return float(f"{value:.7g}")
