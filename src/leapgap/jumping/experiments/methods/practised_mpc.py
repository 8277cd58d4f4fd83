"""The paper's learned variable-frequency MPC: it practises on the robot, and predicts with what it learned there."""

from dataclasses import dataclass, replace

from leapgap.errors import InputError
from leapgap.jumping.experiments.learned_config import PracticeRounds
from leapgap.jumping.experiments.method import Method, References
from leapgap.jumping.experiments.methods.base import MethodSettings
from leapgap.jumping.experiments.methods.mpc import MpcMethod
from leapgap.jumping.experiments.on_policy import Practised, practise
from leapgap.jumping.experiments.rig import LandSettings, Rig
from leapgap.jumping.learning.recipe import ModelSettings
from leapgap.jumping.learning.registry import deviation_recipes
from leapgap.jumping.models.deviation_model import NominalDeviation
from leapgap.jumping.task import Target

NOMINAL = "nominal"
"""In place of a learned model: the same MPC without practice."""


@dataclass(frozen=True)
class PractisedMpcSettings(MethodSettings):
    """The MPC in deviations from the plan, its model learned on the robot itself: section ``land.learned``."""

    name = "practised_mpc"

    grid: str
    """Steps of the MPC and of the model: a key of ``land.grids``."""
    model: str | None = None
    """``nominal``, or a recipe in place of ``land.learned.model``."""

    def check(self, name: str, settings: LandSettings) -> None:
        """Refuse an unknown grid or model."""
        settings.grid(self.grid, name)
        model, known = self.model or settings.learned.model, (NOMINAL, *deviation_recipes())
        if model not in known:
            raise InputError(f"land.method_settings.{name}.model", model, f"one of {', '.join(known)}", "choose one")

    @property
    def practises(self) -> bool:
        """Whether it learns anything."""
        return self.model != NOMINAL

    def start(self, name: str, rig: Rig) -> MpcMethod:
        """The MPC with the nominal model."""
        learned = rig.settings.learned
        config = replace(learned.mpc, grid=rig.settings.grid(self.grid, name))
        return MpcMethod(rig.robot, rig.bench.references, learned.gains, NominalDeviation(rig.body), config)

    def rounds_of(self, rig: Rig) -> PracticeRounds:
        """Rounds, jumps and targets of its practice, by the settings of the rig."""
        return rig.settings.learned.practice

    @property
    def model_settings(self) -> dict[str, ModelSettings]:
        """Of models by their section, where they are not the defaults."""
        return {}

    def plans(self, rig: Rig) -> References:
        """Plans from level ground to the practised targets."""
        return {target: rig.plan(target) for target in map(Target, self.rounds_of(rig).distances_m)}

    def practise(self, name: str, rig: Rig) -> Practised:
        """The rounds of practice on this robot; those that were made before are read."""
        learned = rig.settings.learned
        learned = replace(learned, model=self.model or learned.model, practice=self.rounds_of(rig))
        found = practise(
            rig.bench, self.start(name, rig), self.plans(rig), learned, self.model_settings, f"practice_{name}"
        )
        for number, one in enumerate(found.rounds):
            print(f"{rig.bench.hardware}/{name}, round {number}: {one}", flush=True)
        return found

    def prepare(self, name: str, rig: Rig) -> Method | None:
        """Practise on the robot, unless it was done before."""
        return self.practise(name, rig).method if self.practises else self.start(name, rig)
