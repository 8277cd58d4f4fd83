"""Collection: jumps to different targets from random blocks, by a controller that does not know its hardware."""

from dataclasses import dataclass, field

import numpy as np

from leapgap.effects.base import Effect
from leapgap.jumping.control.excitation import Excitation, Excited
from leapgap.jumping.control.tracking import JumpController
from leapgap.jumping.experiments.landing import Landing
from leapgap.jumping.experiments.method import Method
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.experiments.trial import TrialSetup, attempt_task
from leapgap.logs.log import Log


@dataclass(frozen=True)
class Collected:
    """One jump that was made."""

    log: Log
    landing: Landing
    block_m: float
    fallbacks: dict[str, int]


@dataclass(frozen=True)
class Collection:
    """One jump to make; data, so that it travels to worker processes."""

    name: str
    task: JumpTask
    method: Method
    effects: tuple[Effect, ...]
    world: TrialSetup
    seed: int
    excitation: Excitation = field(default_factory=Excitation)

    def made(self) -> Collected:
        """Let the hardware jump."""
        rng = np.random.default_rng(self.seed)

        def controllers(task: JumpTask) -> list[JumpController]:
            made = self.method(task)
            if self.excitation.force_n == 0:
                return list(made)
            return [Excited(one, self.excitation, rng) for one in made]

        level = self.method.references[self.task.target]
        outcome = attempt_task(self.task, controllers, level, self.effects, self.world, rng)
        log = Log(self.name, outcome.run.log.columns, outcome.run.log.info)
        return Collected(log, outcome.landings[0], self.task.block_m[0], dict(outcome.fallbacks))
