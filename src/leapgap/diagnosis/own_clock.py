"""The cause that logs tell by themselves: rows of other lengths than they claim."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.checks import CheckResult, row_clocks_of
from leapgap.diagnosis.decision import Conclusion
from leapgap.diagnosis.gap import HeldOutGap
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.effects.measurements import SamplePeriod
from leapgap.logs.row_clock import with_clock
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class RestoredPeriod(SamplePeriod):
    """Rows of other lengths than the log claims.

    The log by its own clock has the true lengths already, so this says how far the claim was off, and changes nothing.
    """

    def change_period(self, period_s: float) -> float:
        """The period of the log, which is the true one."""
        return period_s

    def change_rows(self, lengths: np.ndarray) -> np.ndarray:
        """The lengths of the log's rows, which are the true ones."""
        return lengths


@dataclass(frozen=True)
class OwnClock:
    """Logs by their own clock, beside what they claim."""

    judged: JudgedLogs
    """The same logs, channels and sizes, by their own clock."""
    scales: Mapping[str, tuple[float, ...]]
    """True over claimed mean length of a row, by the log's name."""
    robot: Robot

    @property
    def hypothesis(self) -> Hypothesis:
        """The clock as a cause: its share is one, and nothing of it is fitted to what is scored."""
        return Hypothesis(RestoredPeriod, self.robot, per_log=self.scales)

    def with_cause(self, candidate: Candidate, folds: int) -> Candidate:
        """A candidate with the clock as its first cause."""
        numbers = len(candidate.numbers)
        covariance = np.zeros((numbers + 1, numbers + 1))
        covariance[1:, 1:] = candidate.covariance
        of_folds = candidate.fold_numbers if numbers else np.zeros((folds, 0))
        return Candidate(
            (self.hypothesis, *candidate.hypotheses),
            np.concatenate([[1.0], candidate.numbers]),
            covariance,
            np.column_stack([np.ones(len(of_folds)), of_folds]),
        )

    def with_clock(self, conclusion: Conclusion, nominal: Candidate, heldout_gap: HeldOutGap) -> Conclusion:
        """A conclusion about logs by their own clock, with that clock as the first cause.

        The clock is sure. Where nothing else is believed, or what is left is large, it explains the gap partly.
        """
        folds = int(heldout_gap.folds.max()) + 1
        steps = tuple(self.with_cause(step, folds) for step in (nominal, *conclusion.steps))
        answer = ((self.hypothesis.name,), *conclusion.answer)
        verdict = "named" if conclusion.verdict == "none" else conclusion.verdict
        return Conclusion(
            "partly" if verdict == "unknown" else verdict, answer, steps, (1.0, *conclusion.probabilities)
        )


def own_clock(judged: JudgedLogs, checks: Sequence[CheckResult], sizes: Mapping[str, float]) -> OwnClock | None:
    """The logs by their own clock, where a check found that their rows are not as long as they claim.

    The same rows are judged; those that were written at one instant count once.
    """
    clocks = row_clocks_of(checks)
    if clocks is None or any(states.log.name not in clocks for states in judged.whole):
        return None
    logs, rows = [], []
    for whole, cut in zip(judged.whole, judged.rows, strict=True):
        log, kept = with_clock(whole.log, clocks[whole.log.name])
        logs.append(log)
        rows.append(max(2, int(kept[:cut].sum())))
    own = JudgedLogs.of(logs, judged.robot, sizes, rows)
    (result,) = (result for result in checks if result.row_clocks)
    weights = tuple(before / after for before, after in zip(judged.rows, rows, strict=True))
    own = replace(own, channels=judged.channels, mapped=judged.mapped, row_weights=weights)
    return OwnClock(own, result.clocks or {}, judged.robot)
