"""The cause that logs tell by themselves: rows of other lengths than they claim."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.diagnosis.candidates import Candidate, Rival, Undecided, nominal_candidate
from leapgap.diagnosis.checks import CheckResult, row_clocks_of
from leapgap.diagnosis.engine.verdict import Conclusion, Judgement
from leapgap.diagnosis.gap import Interval
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.joint_fit import JointFit
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.effects.measurements import SamplePeriod
from leapgap.logs.row_clock import with_clock
from leapgap.robot.model import Robot

AT_END = "a fitted number is at the end of its range: another cause may act in its place"
STEPS = 2  # Largest number of steps of the fit without evidence, from the answer's numbers on


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

    judged: JudgedLogs  # The same logs, channels and sizes, by their own clock
    scales: Mapping[str, tuple[float, ...]]  # True over claimed mean length of a row, by the log's name
    robot: Robot

    @property
    def hypothesis(self) -> Hypothesis:
        """The clock as a cause: its share is one, and nothing of it is fitted to what is scored."""
        return Hypothesis(RestoredPeriod, self.robot, per_log=self.scales)

    def with_cause(self, candidate: Candidate) -> Candidate:
        """A candidate with the clock as its first cause."""
        numbers, folds = len(candidate.numbers), len(candidate.fold_numbers)
        covariance = np.zeros((numbers + 1, numbers + 1))
        covariance[1:, 1:] = candidate.covariance
        return Candidate(
            (self.hypothesis, *candidate.hypotheses),
            np.concatenate([[1.0], candidate.numbers]),
            covariance,
            np.column_stack([np.ones(folds), candidate.fold_numbers]),
        )

    def conclude(self, joint: JointFit, steps: Sequence[Candidate], sure: Sequence[float]) -> Judgement:
        """The judgement: the clock, which is sure, and the causes of a joint fit after it.

        ``steps`` are fits of the first one, two, … of these, and ``sure`` the probability of each. No value that a
        robot may have fits where a number ends at its range, so that another cause may act then.
        """
        gap, plan = joint.heldout_gap, joint.plan
        every = (nominal_candidate(int(gap.folds.max()) + 1), *steps)
        found, with_clock = every[-1], tuple(map(self.with_cause, every))
        enough = plan.enough_jointly if found.at_bound else plan.enough_closure
        explained = not gap.has_gap or gap.closure_value(*gap.squares([found])) >= enough
        answer = tuple((step.names[-1],) for step in with_clock)
        conclusion = Conclusion("named" if explained else "partly", answer, with_clock, (1.0, *sure))
        undecided = Undecided(fits=(Rival(found.names[0], found),)) if steps else Undecided()
        notes = () if explained or not found.at_bound else (AT_END,)
        return Judgement(conclusion, with_clock[-1], undecided=undecided, notes=notes)


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


def closures_by_source(joint: JointFit, answer: Candidate) -> dict[str, Interval]:
    """Shares of the gap on held-out logs that the answer of a joint fit closes; empty where evidence tells none of it.

    ``evidence``: by the numbers that evidence tells alone; ``fits``: with every number fitted, those of evidence too;
    ``both``: by the answer, in which numbers of evidence are held and the others fitted.
    """
    told = tuple(h for h in answer.hypotheses if joint.is_told(h))
    if not told:
        return {}
    gap = joint.heldout_gap
    numbers = joint.numbers(told).centre
    folds = np.tile(numbers, (int(gap.folds.max()) + 1, 1))
    alone = Candidate(told, numbers, np.diag(joint.numbers(told).spread ** 2), folds)
    fitted = replace(joint, evidence=()).fit(answer.hypotheses, answer.numbers, STEPS)
    evidence, both = gap.squares([alone, answer])
    return {"evidence": gap.closure(evidence), "fits": gap.closure(fitted.heldout), "both": gap.closure(both)}
