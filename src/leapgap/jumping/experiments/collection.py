"""One jump of a data set: made by a controller that does not know the effects on its hardware."""

from dataclasses import dataclass, field

import numpy as np

from leapgap.effects.base import Effect
from leapgap.jumping.control.excitation import Excitation, ExcitedController
from leapgap.jumping.control.tracking import JumpController
from leapgap.jumping.experiments.landing import Landing
from leapgap.jumping.experiments.method import Method
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.experiments.trial import TrialSetup, attempt_task
from leapgap.logs.log import Log


@dataclass(frozen=True)
class CollectionResult:
    """The log of one jump, where it landed, and how often its controller fell back, by reason."""

    log: Log
    landing: Landing
    block_m: float
    fallbacks: dict[str, int]


@dataclass(frozen=True)
class CollectionSpec:
    """One jump to make. It is plain data, so that it can be sent to worker processes."""

    name: str
    task: JumpTask
    method: Method
    effects: tuple[Effect, ...]
    world: TrialSetup
    seed: int
    excitation: Excitation = field(default_factory=Excitation)

    def run(self) -> CollectionResult:
        """Simulate the jump in closed loop; the same seed gives the same result."""
        rng = np.random.default_rng(self.seed)

        def controllers(task: JumpTask) -> list[JumpController]:
            plain = list(self.method(task))
            if self.excitation.force_n == 0:
                return plain
            return [ExcitedController(one, self.excitation, rng) for one in plain]

        level = self.method.references[self.task.target]
        outcome = attempt_task(self.task, controllers, level, self.effects, self.world, rng)
        log = Log(self.name, outcome.run.log.columns, outcome.run.log.info)
        return CollectionResult(log, outcome.landings[0], self.task.block_m[0], dict(outcome.fallbacks))
