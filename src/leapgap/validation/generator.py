"""The simulation that generates the cases of the benchmark.

Its step, integrator and contact differ from those of the diagnosing simulation, and its robots carry small random model
errors (``Nuisance``). Every jump is stepped on its own, so that an off-table effect may keep a state. The robot stands
on its terrain and then jumps, in one run.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from leapgap.effects.base import Effect, recompute_constants
from leapgap.effects.contacts import foot_geoms
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.open_loop import (
    Course,
    MotionPlan,
    extend_reference,
    hold_first_command,
    lift_out_of_ground,
    log_of,
    raise_front,
    with_block,
)
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from leapgap.simulation.sensors import NoiseRows, SensorNoise
from leapgap.validation.off_table import OffTableEffect, Process
from leapgap.validation.uneven_rows import ClockFamily, UnevenRows, limbs_of, uneven_rows, written_log


@dataclass(frozen=True)
class Physics:
    """How the generating simulation differs from the diagnosing one."""

    name: str
    integrator: mujoco.mjtIntegrator
    impedance: tuple[float, float, float]  # first of ``solimp`` of the feet: at the surface and below, width, m
    step_s: float | None = None  # time step; None: that of the setup
    cone: mujoco.mjtCone | None = None  # friction cone; None: that of the model
    friction_impedance: float | None = None  # MuJoCo's ``impratio``; None: that of the model
    contact_time: float = 1.0  # factor on the time constant of the feet's contacts; below one they are stiffer
    accepted: tuple[str, ...] = ()  # effects that a diagnosis may name besides, since this physics has them

    def change_model(self, model: mujoco.MjModel, feet: np.ndarray) -> None:
        """Put the physics into a model; ``feet`` are the geoms of the feet."""
        model.geom_solref[feet, 0] *= self.contact_time
        model.geom_solimp[feet, :3] = self.impedance
        model.opt.integrator = int(self.integrator)
        if self.cone is not None:
            model.opt.cone = int(self.cone)
        if self.friction_impedance is not None:
            model.opt.impratio = self.friction_impedance


INTEGRATOR, CONE = mujoco.mjtIntegrator, mujoco.mjtCone
USUAL = Physics("usual", INTEGRATOR.mjINT_EULER, (0.88, 0.955, 0.0012))  # of cases whose kind asks for no other
IMPLICIT = Physics("implicit", INTEGRATOR.mjINT_IMPLICIT, USUAL.impedance)
"""That of robots whose diagnosing simulation uses Euler's method, as the usual one does."""
OTHERS: Mapping[str, Physics] = {
    physics.name: physics
    for physics in (
        Physics("pyramidal", INTEGRATOR.mjINT_IMPLICIT, (0.9, 0.95, 0.001), 0.0005, CONE.mjCONE_PYRAMIDAL, 10.0),
        Physics("discrete", INTEGRATOR.mjINT_DISCRETE, (0.85, 0.97, 0.002), 0.0002, CONE.mjCONE_ELLIPTIC, 20.0),
        Physics(
            "stiff",
            INTEGRATOR.mjINT_RK4,
            (0.95, 0.99, 0.0005),
            0.000125,
            CONE.mjCONE_ELLIPTIC,
            contact_time=0.3,
            accepted=("foot_compliance",),
        ),
    )
}
"""Physics that are unlike the diagnosing one in other ways, by name."""


def physics_of(name: str) -> Physics:
    """The physics of this name; an unknown name is an ``InputError``."""
    known = {USUAL.name: USUAL, IMPLICIT.name: IMPLICIT, **OTHERS}
    if name not in known:
        raise InputError("withhold", f"physics {name}", f"one of {', '.join(known)}", "correct the name")
    return known[name]


Effects = tuple[Effect, ...]


@dataclass(frozen=True)
class NuisanceSizes:
    """Standard deviations of the generator's model errors, as shares of the model's values; ``com_m`` in m."""

    mass: float = 0.005
    com_m: float = 0.0005
    damping: float = 0.1
    friction: float = 0.05
    armature: float = 0.05
    foot_friction: float = 0.02
    contact_time: float = 0.03  # of the time constant in the ``solref`` of the feet


@dataclass(frozen=True)
class Nuisance(OffTableEffect):
    """Small random errors of masses, centres of mass, joints and feet; the same seed gives the same robot."""

    name = "nuisance"

    seed: int = 0
    sizes: NuisanceSizes = NuisanceSizes()
    physics: Physics = USUAL

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Scale masses and inertias, shift centres of mass, scale joints, feet and contacts."""
        rng, sizes = np.random.default_rng(self.seed), self.sizes
        robots = np.array(robot.bodies)
        scale = 1 + sizes.mass * rng.standard_normal(len(robots))
        model.body_mass[robots] *= scale
        model.body_inertia[robots] *= scale[:, None]
        model.body_ipos[robots] += sizes.com_m * rng.standard_normal((len(robots), 3))
        model.body_sameframe[robots] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)
        model.geom_sameframe[np.isin(model.geom_bodyid, robots)] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)
        dofs = robot.joint_dofs

        def random_scale(size: float, shape: tuple[int, ...]) -> np.ndarray:
            return np.maximum(0.1, 1 + size * rng.standard_normal(shape))

        shape = model.dof_damping[dofs].shape
        model.dof_damping[dofs] *= random_scale(sizes.damping, shape)
        model.dof_frictionloss[dofs] *= random_scale(sizes.friction, (len(dofs),))
        model.dof_armature[dofs] *= random_scale(sizes.armature, (len(dofs),))
        feet = foot_geoms(model, robot, "all") if robot.feet else np.zeros(0, int)
        model.geom_friction[feet, 0] *= random_scale(sizes.foot_friction, (len(feet),))
        model.geom_solref[feet, 0] *= random_scale(sizes.contact_time, (len(feet),))
        self.physics.change_model(model, feet)
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        recompute_constants(model)


class Generator(Replayer):
    """Replays and jumps of the generating simulation; the first effect of each rollout should be a ``Nuisance``."""

    def __init__(self, robot: Robot, terrain_slots: int = 1, step_s: float = 0.00025) -> None:
        super().__init__(robot, terrain_slots, threads=1, largest_step_s=step_s)

    def substeps(self, jump: Log) -> int:
        """Simulation steps of one control period of the log."""
        return max(1, int(np.ceil(jump.info.sample_period_s / self.largest_step_s - 1e-9)))

    def _same_kind(self, trials: Sequence[Rollout], rows: int, substeps: float) -> list[Motion]:
        return [self._stepped(trial, rows, int(substeps)) for trial in trials]

    def _stepped(self, trial: Rollout, rows: int, substeps: int) -> Motion:
        """Motion of one rollout, (rows,), stepped with its processes."""
        if trial.log.rows_before_gain_change < rows:
            raise InputError(trial.log.name, "joint gains that change", "constant gains", "use planned references")
        nq, nv = self.bare.nq, self.bare.nv
        model, control = self.model(trial), self._controls(trial, rows)
        data = mujoco.MjData(model)
        start = self.full_state(trial, model, control)
        ends = np.cumsum([1, model.nq, model.nv])
        _, data.qpos[:], data.qvel[:], data.act[:] = np.split(start, ends)
        made = [e.process(model, self.robot, trial.log) for e in trial.effects if isinstance(e, OffTableEffect)]
        processes = [process for process in made if process is not None]
        data.ctrl[:] = control[0]
        mujoco.mj_forward(model, data)
        qpos, qvel = np.empty((rows, nq)), np.empty((rows, nv))
        qpos[0], qvel[0] = data.qpos[:nq], data.qvel[:nv]
        whole = float(model.opt.timestep)
        lengths = self.row_lengths(trial, rows)
        for row in range(1, rows):
            data.ctrl[:] = control[row - 1]
            # Number of steps of a row of ``length`` periods of ``substeps`` steps of ``step_s`` each
            length = lengths[row - 1]
            steps = int(np.ceil(length * substeps - 1e-9))
            model.opt.timestep = whole if steps in (0, length * substeps) else whole * length * substeps / steps
            step(model, data, processes, steps)
            qpos[row], qvel[row] = data.qpos[:nq], data.qvel[:nv]
        if not (np.isfinite(qpos).all() and np.isfinite(qvel).all()):
            raise InputError(trial.log.name, "a motion that is not finite", "a stable motion", "draw smaller effects")
        return Motion(qpos, qvel)

    def row_lengths(self, trial: Rollout, rows: int) -> np.ndarray:
        """How long the first rows of a log truly last, in true control periods, (rows,)."""
        lengths = np.ones(rows)
        for effect in trial.effects:
            if isinstance(effect, UnevenRows):
                lengths = effect.change_rows(lengths)
        return lengths


def step(model: mujoco.MjModel, data: mujoco.MjData, processes: Sequence[Process], steps: int) -> None:
    """Advance the simulation by ``steps`` steps under constant controls, calling the processes before each step."""
    if steps == 0:
        return
    if not processes:
        mujoco.mj_step(model, data, nstep=steps)
        return
    for _ in range(steps):
        data.xfrc_applied[:], data.qfrc_applied[:] = 0.0, 0.0
        for process in processes:
            process(model, data)
        mujoco.mj_step(model, data)


@dataclass(frozen=True)
class GeneratedJump:
    """One jump of the generator, with and without sensor noise."""

    log: Log
    clean: Log
    rows: UnevenRows | None = None  # how its rows are not what they claim; None: they are what they claim


def generate_jumps(
    plans: Sequence[MotionPlan],
    effects: Sequence[Effects],
    generator: Generator,
    noise: SensorNoise,
    course: Course,
    rng: np.random.Generator,
    clock: ClockFamily | None = None,
    clock_seed: Sequence[int] = (),
) -> list[GeneratedJump]:
    """Let the robot stand and then jump in one run a plan, with its effects; only the jump is logged, by a clock."""
    robot, clock_rng, generated = generator.robot, np.random.default_rng(clock_seed), []
    for plan, own in zip(plans, effects, strict=True):
        jump = with_block(extend_reference(plan.reference, course), plan, robot, course)
        timing = clock.draw(len(jump), len(limbs_of(robot)), clock_rng) if clock else None
        still = hold_first_command(jump, course.settle_s)
        standing = raise_front(generator.first_state(Rollout(still)), plan.block_height_m, robot)
        standing = lift_out_of_ground(Rollout(still, own), standing, generator)
        # The rows of the first log, then those of the second, on the clock of the second
        period = jump.info.sample_period_s
        columns = {name: np.concatenate([still[name], values]) for name, values in jump.columns.items()}
        columns["time"] = np.arange(len(still) + len(jump)) * period
        held = () if timing is None else (UnevenRows(lengths=np.concatenate([np.ones(len(still)), timing.held])),)
        whole = Rollout(replace(jump, columns=columns), (*own, *held), first_state=standing)
        (motion,) = generator.motions([whole])
        motion = Motion(motion.qpos[len(still) :], motion.qvel[len(still) :])
        shown = [NoiseRows.draw(noise, len(motion.qpos), len(robot.joints), rng).add_to(motion, robot), motion]
        rows = None
        if timing is not None:
            rows, jump = uneven_rows(timing), written_log(jump, timing)
            shown = [rows.change_measured(one[timing.written], period, robot) for one in shown]
        log, clean = (log_of(plan.name, jump, one, robot) for one in shown)
        generated.append(GeneratedJump(log, clean, rows))
    return generated
