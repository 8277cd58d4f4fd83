"""The paper's learned variable-frequency MPC: it practises on the robot, and predicts with what it learned there."""

import json
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

from leapgap.errors import InputError
from leapgap.jumping.experiments.method import Method
from leapgap.jumping.experiments.methods.base import MethodSettings
from leapgap.jumping.experiments.methods.mpc import MpcMethod
from leapgap.jumping.experiments.on_policy import practise
from leapgap.jumping.learning.registry import deviation_recipes
from leapgap.jumping.models.deviation_model import NominalDeviation
from leapgap.jumping.task import Target

if TYPE_CHECKING:
    from leapgap.jumping.experiments.rig import LandSettings, Rig

NOMINAL = "nominal"
"""In place of a learned model: the same MPC without practice."""


@dataclass(frozen=True)
class PractisedMpcSettings(MethodSettings):
    """The MPC in deviations from the plan with a model that is learned on the robot itself, section ``land.learned``."""

    name = "practised_mpc"

    grid: str
    """Steps of the MPC and of the model: a key of ``land.grids``."""
    model: str | None = None
    """``nominal``, or a recipe in place of ``land.learned.model``."""

    def check(self, name: str, settings: "LandSettings") -> None:
        """Refuse an unknown grid or model."""
        settings.grid(self.grid, name)
        model, known = self.model or settings.learned.model, (NOMINAL, *deviation_recipes())
        if model not in known:
            raise InputError(f"land.method_settings.{name}.model", model, f"one of {', '.join(known)}", "choose one")

    def prepare(self, name: str, rig: "Rig") -> Method | None:
        """Practise on the robot, unless it was done before."""
        learned = rig.settings.learned
        config = replace(learned.mpc, grid=rig.settings.grid(self.grid, name))
        references, nominal = rig.bench.references, NominalDeviation(rig.body)
        method = MpcMethod(rig.robot, references, learned.gains, model=nominal, config=config)
        if self.model == NOMINAL:
            return method
        learned = replace(learned, model=self.model or learned.model)
        plans = {target: rig.plan(target) for target in map(Target, learned.practice.distances_m)}
        found = practise(rig.bench, method, plans, learned, {}, f"practice_{name}")
        for number, one in enumerate(found.rounds):
            print(f"{rig.bench.hardware}/{name}, round {number}: {json.dumps(asdict(one))}", flush=True)
        return replace(method, model=found.model)
