"""The paper's MPC of the ground forces, predicting with the nominal rigid body or with a learned model."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Self

import numpy as np

from leapgap.effects.base import Effect
from leapgap.jumping.control.excitation import Excitation, ExcitedController
from leapgap.jumping.control.inference import load
from leapgap.jumping.control.mpc_config import MpcConfig
from leapgap.jumping.control.mpc_controller import JumpMpc
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.control.tracking import JumpController
from leapgap.jumping.experiments.landing_model import LandingSamples
from leapgap.jumping.experiments.method import Method, PlanSource
from leapgap.jumping.experiments.methods.base import MethodSettings
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.learning.windows import Purpose
from leapgap.jumping.models.affine_model import PredictionModel
from leapgap.jumping.models.deviation_model import DeviationModel
from leapgap.jumping.models.rigid_body_model import RigidBodyModel
from leapgap.logs.log import Log

if TYPE_CHECKING:  # so that jumps are collected without the rig of landings
    from leapgap.jumping.experiments.rig import LandSettings, Rig


@dataclass(frozen=True)
class MpcMethod(Method):
    """The paper's MPC with a prediction model."""

    model: PredictionModel | DeviationModel | None = None
    config: MpcConfig = field(default_factory=MpcConfig)
    excitation: Excitation | None = None
    """Random forces on top of its own, by ``seed``."""
    seed: int = 0
    identified: tuple[Effect, ...] | None = None
    """Effects that were identified in the robot; None: none were looked for."""

    def excited(self, excitation: Excitation, seed: int) -> Self:
        """The same with random forces, as for practice."""
        return replace(self, excitation=excitation, seed=seed)

    def taught(self, model: DeviationModel, rounds: Sequence[LandingSamples]) -> Self:
        """The same after some rounds of practice: with their model, and where goals were chosen with their landings."""
        del rounds
        return replace(self, model=model)

    def flown(self, jump: Log, plan: Log, samples: LandingSamples) -> tuple[Log, Log] | None:
        """A jump from its begin on, and its plan; None where it is not to be learned from.

        ``plan`` is that from level ground, ``samples`` the goal that was chosen instead, if any.
        """
        del samples
        return jump, plan

    def controller(self, task: JumpTask, reference: Reference) -> JumpController:
        """The MPC along the plan."""
        assert self.model is not None
        return self.with_excitation(JumpMpc(reference, self.robot, self.gains, self.model, self.config))

    def with_excitation(self, controller: JumpController) -> JumpController:
        """A controller with the random forces, if any."""
        if self.excitation is None:
            return controller
        return ExcitedController(controller, self.excitation, np.random.default_rng(self.seed))


@dataclass(frozen=True)
class NominalMpcSettings(MethodSettings):
    """The MPC whose prediction model is the rigid body of the robot that the plans are made for."""

    name = "nominal_mpc"

    grid: str
    """Steps of the MPC: a key of ``land.grids``."""
    plans: PlanSource = PlanSource.own

    def check(self, name: str, settings: "LandSettings") -> None:
        """Refuse an unknown grid, or plans without their inputs."""
        settings.check_plans(self.plans)
        settings.grid(self.grid, name)

    def prepare(self, name: str, rig: "Rig") -> Method | None:
        """The MPC with the nominal rigid body; it needs no training."""
        plans = rig.plans(self.plans)
        if plans is None:
            return None
        config = replace(rig.settings.mpc, grid=rig.settings.grid(self.grid, name))
        return MpcMethod(rig.robot, plans.references, model=RigidBodyModel(plans.body), config=config)


@dataclass(frozen=True)
class LearnedMpcSettings(MethodSettings):
    """The MPC whose prediction model is ``land.model``, trained on all jumps for these steps."""

    name = "learned_mpc"

    grid: str
    """Steps of the MPC: a key of ``land.grids``."""
    models: str
    """Folder of stage train: a key of ``land.models``."""
    plans: PlanSource = PlanSource.own

    def check(self, name: str, settings: "LandSettings") -> None:
        """Refuse an unknown grid or folder, or plans without their inputs."""
        settings.check_plans(self.plans)
        settings.grid(self.grid, name)
        settings.folder(self.models, name)

    def prepare(self, name: str, rig: "Rig") -> Method | None:
        """Read the exported model; without one the method is left out."""
        plans = rig.plans(self.plans)
        if plans is None:
            return None
        settings = rig.settings
        folder = settings.folder(self.models, name) / "exported"
        if not folder.is_dir():
            print(f"{name}: no trained models in {folder}, left out", flush=True)
            return None
        grid = settings.grid(self.grid, name)
        model = load(folder, settings.model, Purpose(grid, settings.schedule, rig.robot.name, rig.robot.sha256))
        return MpcMethod(rig.robot, plans.references, model=model, config=replace(settings.mpc, grid=grid))
