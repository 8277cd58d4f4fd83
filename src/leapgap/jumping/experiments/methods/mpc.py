"""The paper's MPC of the ground forces, predicting with the nominal rigid body or with a learned model."""

from dataclasses import dataclass, replace

from leapgap.jumping.control.inference import load
from leapgap.jumping.experiments.method import Method, MpcMethod
from leapgap.jumping.experiments.rig import MethodSettings, Rig
from leapgap.jumping.experiments.settings import LandSettings, PlanSource
from leapgap.jumping.learning.windows import Purpose
from leapgap.jumping.models.rigid_body import RigidBodyModel


@dataclass(frozen=True)
class NominalMpcSettings(MethodSettings):
    """The MPC whose prediction model is the rigid body of the robot that the plans are made for."""

    name = "nominal_mpc"

    grid: str  # Steps of the MPC: a key of ``land.grids``
    plans: PlanSource = PlanSource.own

    def check(self, name: str, settings: LandSettings) -> None:
        """Refuse an unknown grid, or plans without their inputs."""
        settings.check_plans(self.plans)
        settings.grid(self.grid, name)

    def prepare(self, name: str, rig: Rig) -> Method | None:
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

    grid: str  # Steps of the MPC: a key of ``land.grids``
    models: str  # Folder of stage train: a key of ``land.models``
    plans: PlanSource = PlanSource.own

    def check(self, name: str, settings: LandSettings) -> None:
        """Refuse an unknown grid or folder, or plans without their inputs."""
        settings.check_plans(self.plans)
        settings.grid(self.grid, name)
        settings.folder(self.models, name)

    def prepare(self, name: str, rig: Rig) -> Method | None:
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
