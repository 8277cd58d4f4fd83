"""Joint PD with the torques of the plan as feed-forward: the baseline of all methods."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from leapgap.jumping.control.reference import Reference
from leapgap.jumping.control.tracking import JointPd, JumpController
from leapgap.jumping.experiments.method import Method, PlanSource, shift_target
from leapgap.jumping.experiments.methods.base import MethodSettings
from leapgap.jumping.experiments.tasks import JumpTask

if TYPE_CHECKING:  # so that jumps are collected without the rig of landings
    from leapgap.jumping.experiments.rig import LandSettings, Rig


@dataclass(frozen=True)
class JointPdMethod(Method):
    """Joint PD and the planned torques, of a plan that goes ``shift_m`` farther than the target."""

    shift_m: float = 0.0

    def reference(self, task: JumpTask) -> Reference:
        """The plan to the shifted target."""
        return Reference.of(self.references[shift_target(task.target, self.shift_m)], self.robot)

    def controller(self, task: JumpTask, reference: Reference) -> JumpController:
        """Joint PD along the plan, with its torques as feed-forward."""
        return JointPd(reference, self.robot, self.gains)


@dataclass(frozen=True)
class JointPdSettings(MethodSettings):
    """Joint PD along the plans for one robot."""

    name = "joint_pd"

    plans: PlanSource = PlanSource.own

    def check(self, name: str, settings: "LandSettings") -> None:
        """Refuse settings that lack the inputs of these plans."""
        settings.check_plans(self.plans)

    def prepare(self, name: str, rig: "Rig") -> Method | None:
        """Joint PD along the plans; it needs no training."""
        plans = rig.plans(self.plans)
        return None if plans is None else JointPdMethod(rig.robot, plans.references)
