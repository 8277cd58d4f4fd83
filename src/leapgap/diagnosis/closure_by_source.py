"""What evidence alone, fits alone, and both together close of the gap: whether the one needs the other."""

from dataclasses import dataclass, replace

import numpy as np

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.closure import Interval
from leapgap.diagnosis.joint_fit import JointFit

STEPS = 2  # Largest number of steps of the fit without evidence, from the answer's numbers on


@dataclass(frozen=True)
class ClosureBySource:
    """Shares of the headline gap that are closed on held-out logs."""

    evidence: Interval  # By the numbers that evidence tells, and nothing fitted
    fits: Interval  # By the answer's effects with every number fitted, those of evidence too
    both: Interval  # By the answer: numbers of evidence are held, the others fitted


def closure_by_source(joint: JointFit, answer: Candidate) -> ClosureBySource | None:
    """The three closures for the answer of a joint fit; None where evidence tells none of its numbers."""
    told = tuple(h for h in answer.hypotheses if joint.is_told(h))
    if not told:
        return None
    gap = joint.heldout_gap
    numbers = joint.numbers(told).centre
    folds = np.tile(numbers, (int(gap.folds.max()) + 1, 1))
    alone = Candidate(told, numbers, np.diag(joint.numbers(told).spread ** 2), folds)
    fitted = replace(joint, evidence=()).fit(answer.hypotheses, answer.numbers, STEPS)
    evidence, both = gap.squares([alone, answer])
    return ClosureBySource(gap.closure(evidence), gap.closure(fitted.heldout), gap.closure(both))
