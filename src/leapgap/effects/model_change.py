"""What one model file of a robot changes in another, as effects that add a share of each change."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import inf

import mujoco
import numpy as np

from leapgap import effects
from leapgap.effects.base import Effect, parameter, recompute_constants
from leapgap.effects.bodies import move_centre
from leapgap.effects.model_field import FRAMES, ROWS, WHOLE
from leapgap.errors import InputError
from leapgap.robot.model import Robot

FIELDS = {
    "dof_damping": "damping",
    "dof_dampingpoly": "damping of higher order",
    "dof_frictionloss": "dry friction",
    "dof_armature": "armature",
    "jnt_stiffness": "stiffness",
    "qpos_spring": "rest position of the spring",
    "jnt_pos": "place of the joint",
    "jnt_axis": "axis of the joint",
    "jnt_range": "range of the joint",
    "body_pos": "place on its parent",
    "body_quat": "attitude on its parent",
    "body_gravcomp": "compensation of gravity",
    "geom_friction": "friction of contacts",
    "geom_solref": "solref of contacts",
    "geom_solimp": "solimp of contacts",
    "geom_size": "size",
    "geom_pos": "place",
    "opt.gravity": "gravity",
    "opt.density": "density of the air",
    "opt.viscosity": "viscosity of the air",
    "opt.wind": "wind",
}
"""Fields of a model that are compared number by number → words."""
MASS, INERTIA = "mass and centre of mass", "inertia"
POSITIVE = ("dof_damping", "dof_frictionloss", "dof_armature", "jnt_stiffness")
"""Fields that no share of a change makes negative."""
ROUNDING = 1e-5  # largest relative difference of numbers that files round
MOST = 2.0  # largest share of a change
GAINS = {"gain": "torque_gain", "kp": "position_gain", "kd": "velocity_gain", "limit": "torque_limit"}
"""Numbers of the makers' actuators → the effect that scales them."""


@dataclass(frozen=True)
class StatedChange:
    """One change that somebody's model makes to the nominal one."""

    title: str  # Number and part in words, such as ``damping of elbow``
    says: str  # ``0.05 → 0.45``
    effect: Effect  # It adds the whole change to the nominal robot


@dataclass(frozen=True)
class Difference:
    """Numbers of one element of a model in two files."""

    field: str
    element: str  # Name of the body, joint or geom; empty for the whole simulation
    row: int  # Index of the element in both files, for bodies without a name
    before: np.ndarray
    after: np.ndarray

    def place(self, model: mujoco.MjModel) -> int:
        """The row of the element in the field of a model."""
        return ROWS[self.field.partition("_")[0]](model, self.element) if self.element else self.row

    def add(self, model: mujoco.MjModel, share: float) -> None:
        """Add a share of the difference to a model."""
        by = share * (self.after - self.before)
        if self.field.startswith(f"{WHOLE}."):
            name = self.field.removeprefix(f"{WHOLE}.")
            own = getattr(model.opt, name)
            setattr(model.opt, name, own + by if isinstance(own, np.ndarray) else float(own + by))
            return
        values, row = getattr(model, self.field), self.place(model)
        changed = values[row] + by
        values[row] = np.maximum(changed, 0) if self.field in POSITIVE else changed
        if self.field in ("body_quat", "jnt_axis"):
            values[row] /= np.linalg.norm(values[row])
        for mark in FRAMES.get(self.field, ()):
            getattr(model, mark)[row] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)


@dataclass(frozen=True)
class MassDifference(Difference):
    """Mass, kg, and first moment about the body's origin, kg·m, (4,): linear in what forces they need."""

    def add(self, model: mujoco.MjModel, share: float) -> None:
        """Add a share of both; the inertia about the centre of mass stays."""
        body, by = self.place(model), share * (self.after - self.before)
        mass = float(model.body_mass[body])
        moment, whole = mass * model.body_ipos[body] + by[1:], mass + float(by[0])
        if whole > 0:
            model.body_mass[body] = whole
            move_centre(model, body, moment / whole - model.body_ipos[body])


@dataclass(frozen=True)
class InertiaDifference(Difference):
    """Inertia about the centre of mass in the body's axes, kg·m², (9,)."""

    def add(self, model: mujoco.MjModel, share: float) -> None:
        """Add a share of it."""
        body = self.place(model)
        changed = inertia_of(model, body) + share * (self.after - self.before)
        values, vectors = np.linalg.eigh(changed.reshape(3, 3))
        if values[0] <= 0:
            return
        vectors[:, 0] *= np.sign(np.linalg.det(vectors))
        model.body_inertia[body] = values
        mujoco.mju_mat2Quat(model.body_iquat[body], np.ascontiguousarray(vectors).ravel())
        for mark in FRAMES["body_iquat"]:
            rows = model.geom_bodyid == body if mark == "geom_sameframe" else body
            getattr(model, mark)[rows] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)


def inertia_of(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Inertia of a body about its centre of mass in its axes, kg·m², (9,)."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    axes = turn.reshape(3, 3)
    return np.asarray(axes @ np.diag(model.body_inertia[body]) @ axes.T).ravel()


def share_effect(title: str, difference: Difference) -> Effect:
    """The effect that adds a share of a difference, at the whole of it."""

    @dataclass(frozen=True)
    class ShareOfChange(Effect):
        name = title

        share: float = parameter(0.0, "1", 0.0, MOST, 1.0, limits=(-inf, inf))

        def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
            """Add the share."""
            if self.share:
                difference.add(model, self.share)
                recompute_constants(model)

    ShareOfChange.__module__ = ShareOfChange.__qualname__ = title  # it is the user's, in no file of this package
    return ShareOfChange(share=1.0)


def changes_between(nominal: Robot, stated: Robot) -> list[StatedChange]:
    """All changes that a model file of the same robot makes to the nominal one, element by element.

    ``InputError`` where the two have other joints or bodies. What is of the simulation (step, solver) is no change.
    """
    for what, own, other in (
        ("joints", nominal.joints, stated.joints),
        ("bodies", names_of_bodies(nominal.model), names_of_bodies(stated.model)),
    ):
        if own != other:
            missing = ", ".join(sorted(set(own) ^ set(other))) or "the same in another order"
            do = "name the model that this file corrects with --nominal"
            raise InputError(stated.path, f"other {what} than {nominal.path}: {missing}", "the same robot", do)
    found = [change_of(one) for one in differences(nominal.model, stated.model)]
    return [*found, *actuator_changes(nominal, stated)]


def names_of_bodies(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of all bodies in the order of the model."""
    return tuple(model.body(body).name for body in range(model.nbody))


def differences(before: mujoco.MjModel, after: mujoco.MjModel) -> Iterator[Difference]:
    """Elements whose numbers differ by more than rounding."""
    for body in range(1, before.nbody):
        masses, inertias = ([of(model, body) for model in (before, after)] for of in (mass_and_moment, inertia_of))
        name = before.body(body).name
        if differ(*masses):
            yield MassDifference("body_mass", name, body, *masses)
        if differ(*inertias):
            yield InertiaDifference("body_inertia", name, body, *inertias)
    for field in FIELDS:
        if field.startswith(f"{WHOLE}."):
            both = [np.array(getattr(model.opt, field.removeprefix(f"{WHOLE}."))) for model in (before, after)]
            if differ(*both):
                yield Difference(field, "", 0, *both)
            continue
        prefix = field.partition("_")[0]
        for name in elements(before, after, "joint" if prefix in ("dof", "jnt", "qpos") else prefix):
            row, other = ROWS[prefix](before, name), ROWS[prefix](after, name)
            both = [np.array(getattr(before, field)[row]), np.array(getattr(after, field)[other])]
            if differ(*both):
                yield Difference(field, name, row, *both)


def elements(before: mujoco.MjModel, after: mujoco.MjModel, kind: str) -> list[str]:
    """Names of the joints, bodies or geoms that both models have; a free joint has none of these numbers."""
    count = {"joint": "njnt", "body": "nbody", "geom": "ngeom"}[kind]
    names = [[getattr(model, kind)(i).name for i in range(getattr(model, count))] for model in (before, after)]
    return [name for name in names[0] if name and name in names[1]]


def mass_and_moment(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Mass of a body, kg, and its first moment about the body's origin, kg·m, (4,)."""
    return np.append(model.body_mass[body], model.body_mass[body] * model.body_ipos[body])


def differ(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether two sets of numbers differ by more than what files round."""
    size = max(float(np.abs(before).max()), float(np.abs(after).max()))
    return bool(np.abs(after - before).max() > ROUNDING * size)


def change_of(of: Difference) -> StatedChange:
    """A difference as a change, in words."""
    what = {"body_mass": MASS, "body_inertia": INERTIA, **FIELDS}[of.field]
    title = f"{what} of {of.element or f'body {of.row}'}" if not of.field.startswith(WHOLE) else what
    pairs = [numbers_of(of, side) for side in (of.before, of.after)]
    return StatedChange(title, " → ".join(pairs), share_effect(title, of))


def numbers_of(of: Difference, side: np.ndarray) -> str:
    """The numbers of one file in words."""
    if isinstance(of, MassDifference):
        centre = ", ".join(f"{value:.4g}" for value in side[1:] / max(side[0], 1e-12))
        return f"{side[0]:.4g} kg at ({centre}) m"
    if isinstance(of, InertiaDifference):
        return "(" + ", ".join(f"{value:.3g}" for value in np.linalg.eigvalsh(side.reshape(3, 3))) + ") kg·m²"
    flat = np.atleast_1d(side)
    return f"{flat[0]:.4g}" if len(flat) == 1 else "(" + ", ".join(f"{value:.4g}" for value in flat) + ")"


def actuator_changes(nominal: Robot, stated: Robot) -> Iterator[StatedChange]:
    """Gains and limits of the makers' actuators that differ, as effects on what the logs' own commands do."""
    before, after = makers_numbers(nominal), makers_numbers(stated)
    for joint in nominal.driven_joints:
        for key, name in GAINS.items():
            own, other = before[joint][key], after[joint][key]
            if not (own and other and np.isfinite([own, other]).all() and differ(np.array(own), np.array(other))):
                continue
            title = f"{name.replace('_', ' ')} of {joint}"
            yield StatedChange(title, f"{own:.4g} → {other:.4g}", effects.effect(name, joint, scale=other / own))


def makers_numbers(robot: Robot) -> Mapping[str, dict[str, float]]:
    """Of each joint that is driven, the makers' gain of a torque motor, stiffness and damping of a servo, limit."""
    model = robot.published_spec().compile()
    found = {}
    for motor in robot.actuators:
        numbers = {"gain": 0.0, "kp": 0.0, "kd": 0.0, "limit": max(abs(end) for end in motor.limit)}
        for i in range(model.nu):
            if model.joint(model.actuator_trnid[i, 0]).name != motor.joint:
                continue
            gear = float(model.actuator_gear[i, 0])
            numbers["kp"] -= gear**2 * float(model.actuator_biasprm[i, 1])
            numbers["kd"] -= gear**2 * float(model.actuator_biasprm[i, 2])
            if not model.actuator_biasprm[i].any():
                numbers["gain"] += gear * float(model.actuator_gainprm[i, 0])
        found[motor.joint] = numbers
    return found
