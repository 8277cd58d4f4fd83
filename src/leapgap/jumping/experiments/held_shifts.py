"""Practice jumps that find what late shifts do: each holds one shift from one of the last free updates on.

While the front feet leave the ground, what a shift does turns within 50 ms from all of it to its opposite. When that
happens depends on the feet, the ground and the delays, which a simulation of the robot does not know well enough. Few
jumps of the robot itself tell it.
"""

from dataclasses import dataclass, replace

import numpy as np

from leapgap.jumping.control.shift_horizon import ShiftGrid
from leapgap.jumping.control.shifted_plan import GOAL_AXES
from leapgap.jumping.experiments.bench import Bench
from leapgap.jumping.experiments.landing_feedback import HeldShifts
from leapgap.jumping.experiments.landing_model import LandingModel, best_goal, target_pose
from leapgap.jumping.experiments.methods.goal_shift import GoalShiftMethod
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.experiments.trial_spec import TrialResult, TrialSpec


@dataclass(frozen=True)
class HeldShiftsConfig:
    """Which shifts are held; one jump each, and one without a shift for each distance."""

    distances_m: tuple[float, ...] = (0.45, 0.55, 0.65)
    """Distances of the targets, rising; on flat ground. What a late shift does may turn within 5 cm of distance."""
    last_updates: int = 4
    """Number of updates, the last ones at which a shift may change. Before them the simulation is right."""
    shift: tuple[float, float, float] = (0.03, 0.0, 0.06)
    """Shift along each axis, m, m, rad; 0: none is held along it. Its sign changes from update to update."""
    error: float = 0.15
    """Standard deviation of a measured effect, m/m and the like: noise and scatter of two landings."""


def measure_held_shifts(
    bench: Bench, method: GoalShiftMethod, landing: LandingModel, grid: ShiftGrid, config: HeldShiftsConfig, folder: str
) -> HeldShifts:
    """Make the jumps, and compare their landings with those without a shift; those that fall are left out.

    ``method`` has no model, and ``landing`` chooses its goals. ``folder`` is that of the method's practice.
    """
    last = range(max(grid.free_updates - config.last_updates, 0), grid.free_updates)
    held = [(update, axis) for update in last for axis in range(GOAL_AXES) if config.shift[axis]]
    steps = np.array([sign(update) * config.shift[axis] for update, axis in held])
    unshifted = np.zeros((grid.updates, GOAL_AXES))
    shifts = [unshifted, *(held_shift(unshifted, *at, step) for at, step in zip(held, steps, strict=True))]
    rng = np.random.default_rng([bench.seed, 17])
    goals, effects = [], []
    for x_m in sorted(config.distances_m):
        task = JumpTask("held", x_m)
        offset = best_goal(landing, task.target, 0.0) - target_pose(task.target)
        aimed = replace(method, references={task.target: bench.level}, goal_offset=offset)
        trials = [
            TrialSpec(
                f"{bench.hardware}/{folder}/held_{round(1000 * x_m)}_{number:02d}",
                task,
                replace(aimed, exploration=shift),
                bench.level,
                bench.effects,
                bench.world,
                int(rng.integers(2**31)),
            )
            for number, shift in enumerate(shifts)
        ]
        landings = [landing_of(result) for result in bench.runner.results(trials)]
        if np.isfinite(landings[0]).all():
            goals.append(float(best_goal(landing, task.target, 0.0)[0]))
            effects.append((np.array(landings[1:]) - landings[0]) / steps[:, None])
    return HeldShifts(
        x_m=np.array(goals),
        update=np.array([update for update, _ in held], dtype=int),
        axis=np.array([axis for _, axis in held], dtype=int),
        effect=np.array(effects).reshape(len(goals), len(held), GOAL_AXES),
        error=config.error,
    )


def held_shift(unshifted: np.ndarray, update: int, axis: int, step: float) -> np.ndarray:
    """A shift by ``step`` along an axis that is held from an update on, (updates, 3)."""
    shift = unshifted.copy()
    shift[update:, axis] = step
    return shift


def landing_of(result: TrialResult) -> np.ndarray:
    """Landing (3,) of the result's jump; not finite where it fell."""
    return np.full(GOAL_AXES, np.nan) if result.shifted is None else result.shifted.landing[0]


def sign(update: int) -> float:
    """Sign of the shift that is held from an update on: both in turn, so that the mean effect of both sides counts."""
    return 1.0 if update % 2 else -1.0
