"""Joint PD whose target is shifted by one constant, learned from the mean error: a calibrated offset, and no more."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.control.gains import PhaseGains
from leapgap.jumping.experiments.bench import Bench
from leapgap.jumping.experiments.method import Method, shifted
from leapgap.jumping.experiments.methods.base import MethodSettings
from leapgap.jumping.experiments.methods.joint_pd import ByJointPd
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.logs.log import Log
from leapgap.logs.segments import Target

if TYPE_CHECKING:
    from leapgap.jumping.experiments.rig import Rig


SHIFTING = 900
"""Number of the first run that the shift is learned from: other ground and sensors than in those that count."""


@dataclass(frozen=True)
class JointPdShiftedSettings(MethodSettings):
    """The shift is learned on the tasks ``land.single``."""

    name = "joint_pd_shifted"

    def prepare(self, name: str, rig: "Rig") -> Method | None:
        """Learn the shift."""
        singles = [task for task in rig.tasks if task.name in rig.settings.single]
        if not singles:
            raise InputError("land.single", "none of the tasks", "one or more to learn a shift on", "name one")
        return best_shift(rig.bench, singles, rig.tasks, rig.plan)


def best_shift(
    bench: Bench, learned_on: Sequence[JumpTask], tasks: Sequence[JumpTask], plan: Callable[[Target], Log]
) -> ByJointPd:
    """Joint PD with the constant shift of the target that lands best over some tasks: two steps of correction."""
    references = dict(bench.references)
    method = ByJointPd(bench.robot, references, PhaseGains())

    def moved(shift_m: float, of: Sequence[JumpTask]) -> ByJointPd:
        for task in of:
            goal = shifted(task.target, shift_m)
            if goal not in references:
                references[goal] = plan(goal)
        return replace(method, references=dict(references), shift_m=shift_m)

    for number in range(2):
        trials = [bench.trial("shifting", method, task, SHIFTING + number) for task in learned_on]
        errors = [done.landings[0].error_cm / 100 for done in bench.runner.results(trials)]
        method = moved(round(method.shift_m + float(np.mean(errors)), 3), learned_on)
    return moved(method.shift_m, tasks)
