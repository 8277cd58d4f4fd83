"""Joint PD and the torques of the plan: what every other method has to beat."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from leapgap.jumping.control.reference import Reference
from leapgap.jumping.control.tracking import JointPd, JumpController
from leapgap.jumping.experiments.method import Method, shifted
from leapgap.jumping.experiments.methods.base import MethodSettings, PlanSource
from leapgap.jumping.experiments.tasks import JumpTask

if TYPE_CHECKING:
    from leapgap.jumping.experiments.rig import LandSettings, Rig


@dataclass(frozen=True)
class ByJointPd(Method):
    """Joint PD and the planned torques, of a plan that goes ``shift_m`` farther than the target."""

    shift_m: float = 0.0

    def reference(self, task: JumpTask) -> Reference:
        """The plan to the shifted target."""
        return Reference.of(self.references[shifted(task.target, self.shift_m)], self.robot)

    def controller(self, task: JumpTask, reference: Reference) -> JumpController:
        """Joint PD along the plan, with its torques as feed-forward."""
        return JointPd(reference, self.robot, self.gains)


@dataclass(frozen=True)
class JointPdSettings(MethodSettings):
    """Joint PD along the plans for one robot."""

    name = "joint_pd"

    plans: PlanSource = PlanSource.own

    def check(self, name: str, settings: "LandSettings") -> None:
        """The plans need their inputs."""
        settings.check_plans(self.plans)

    def prepare(self, name: str, rig: "Rig") -> Method | None:
        """Nothing has to be learned."""
        plans = rig.plans(self.plans)
        return None if plans is None else ByJointPd(rig.robot, plans.references)
