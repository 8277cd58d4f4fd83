"""The horizons at which replays are judged, and the longest one at which they say anything.

A robot under tight joint control is replayed over a whole log. One that is driven by torques, or falls, soon does
something else for reasons as small as noise; over a shorter time its replay still says what the model lacks.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.channels import channel_errors
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.restarts import restarts

HORIZONS_S = (0.1, 0.3, 1.0)  # Horizons at which errors are told, beside whole logs
INFORMATIVE = 0.5  # A replay is informative while its error is below this share of that of a robot that does not move


@dataclass(frozen=True)
class HorizonGap:
    """The headline gap of replays that restart after a horizon."""

    horizon_s: float | None  # None: whole logs
    nominal: float
    unmoved: float  # That of a robot that does not move at each start

    @property
    def is_informative(self) -> bool:
        """Whether the replay is clearly nearer than a robot that does nothing."""
        return self.nominal < INFORMATIVE * self.unmoved


def horizons_of(judged: JudgedLogs) -> list[float | None]:
    """Horizons that are shorter than the longest log, longest first, whole logs before them; of jumps the latter alone.

    The gap of jumps is that of whole logs by definition, so that no other horizon is worth the time of its replays.
    """
    if judged.preset == "jump":
        return [None]
    longest = max(float(log.time[-1]) for log in judged.logs)
    return [None, *(horizon for horizon in sorted(HORIZONS_S, reverse=True) if horizon < longest)]


def gap_of(errors: Sequence[np.ndarray]) -> float:
    """Root mean square of scaled errors (rows, channels) of all logs."""
    return float(np.sqrt(sum((e**2).sum() for e in errors) / sum(e.size for e in errors)))


def unmoved_errors(judged: JudgedLogs, horizon_s: float | None) -> list[np.ndarray]:
    """Scaled errors (rows, channels) of each log for a robot that does not move at each start."""
    found = []
    for log, motion in zip(judged.logs, judged.motions, strict=True):
        rows = len(log) if horizon_s is None else log.info.rows(horizon_s)
        begins = np.array(restarts(len(log), rows))
        held = begins[np.searchsorted(begins, np.arange(len(log)), side="right") - 1]
        found.append(channel_errors(motion[held], motion, judged.channels, judged.robot) / judged.scales)
    return found


def longest_informative(gaps: Sequence[HorizonGap]) -> HorizonGap:
    """The longest horizon at which the nominal robot is informative; the shortest where it never is."""
    return next((gap for gap in gaps if gap.is_informative), gaps[-1])
