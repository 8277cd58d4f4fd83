"""Joint PD with the torques of the plan as feed-forward: the baseline of all methods."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.control.tracking import PhaseGains
from leapgap.jumping.experiments.method import JointPdMethod, JumpTask, Method, shift_target
from leapgap.jumping.experiments.rig import Bench, LandSettings, MethodSettings, PlanSource, Rig
from leapgap.jumping.task import Target
from leapgap.logs.log import Log


@dataclass(frozen=True)
class JointPdSettings(MethodSettings):
    """Joint PD along the plans for one robot."""

    name = "joint_pd"

    plans: PlanSource = PlanSource.own

    def check(self, name: str, settings: LandSettings) -> None:
        """Refuse settings that lack the inputs of these plans."""
        settings.check_plans(self.plans)

    def prepare(self, name: str, rig: Rig) -> Method | None:
        """Joint PD along the plans; it needs no training."""
        plans = rig.plans(self.plans)
        return None if plans is None else JointPdMethod(rig.robot, plans.references)


FIRST_SHIFT_RUN = 900
"""Number of the first run that the shift is learned from; ground and sensors differ from those of the scored runs."""


@dataclass(frozen=True)
class JointPdShiftedSettings(MethodSettings):
    """The shift is learned on the tasks ``land.single``."""

    name = "joint_pd_shifted"

    def prepare(self, name: str, rig: Rig) -> Method | None:
        """Make jumps of the tasks ``land.single``, and learn the shift from them."""
        singles = [task for task in rig.tasks if task.name in rig.settings.single]
        if not singles:
            raise InputError("land.single", "none of the tasks", "one or more to learn a shift on", "name one")
        return learn_shift(rig.bench, singles, rig.tasks, rig.plan)


def learn_shift(
    bench: Bench, learned_on: Sequence[JumpTask], tasks: Sequence[JumpTask], plan: Callable[[Target], Log]
) -> JointPdMethod:
    """Joint PD with one shift of all targets, corrected twice by the mean landing error of the tasks ``learned_on``."""
    references = dict(bench.references)
    method = JointPdMethod(bench.robot, references, PhaseGains())

    def with_shift(shift_m: float, planned_tasks: Sequence[JumpTask]) -> JointPdMethod:
        for task in planned_tasks:
            goal = shift_target(task.target, shift_m)
            if goal not in references:
                references[goal] = plan(goal)
        return replace(method, references=dict(references), shift_m=shift_m)

    for number in range(2):
        trials = [bench.trial("shifting", method, task, FIRST_SHIFT_RUN + number) for task in learned_on]
        errors = [done.landings[0].error_cm / 100 for done in bench.runner.results(trials)]
        method = with_shift(round(method.shift_m + float(np.mean(errors)), 3), learned_on)
    return with_shift(method.shift_m, tasks)
