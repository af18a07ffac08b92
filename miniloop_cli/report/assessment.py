"""The first section of the page: the outcome, how far it can be trusted, and advice."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from miniloop_cli.errors import MiniloopError
from miniloop_cli.evaluation.evaluate import Evaluation
from miniloop_cli.results.assessment import Assessment, Level, judge
from miniloop_cli.results.columns import ReportData

if TYPE_CHECKING:
    from miniloop_cli.inspection.findings import Finding


def assess(data: ReportData, evaluation: Evaluation | None) -> Assessment:
    """The assessment of a run; if it is not good, with the findings on the recording."""
    found = judge(data.columns, evaluation)
    return found if found.level == Level.GOOD else replace(found, findings=recording_findings(data))


def recording_findings(data: ReportData) -> tuple[Finding, ...]:
    """The findings of `miniloop inspect` on the recording, with the camera of this run; none without the recording."""
    if data.sequence is None:
        return ()
    from miniloop_cli.inspection.inspect import inspect

    seed = data.summary.get("seed")
    rng = np.random.default_rng(seed if isinstance(seed, int) and seed >= 0 else 0)
    try:
        found = inspect(data.sequence, rng).findings
    except MiniloopError:
        return ()
    return tuple(finding for finding in found if finding.level != "note")
