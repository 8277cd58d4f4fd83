"""Contacts of the feet and the ground under them."""

from dataclasses import dataclass
from math import inf

import mujoco
import numpy as np

from leapgap.effects.base import Effect, Parameter, mean_of, parameter, recompute_constants
from leapgap.effects.bodies import GravityDirection
from leapgap.effects.measurements import FrameTilt
from leapgap.robot.model import Robot
from leapgap.robot.terrain import ground_bodies, ground_geoms, ground_of_spec


@dataclass(frozen=True)
class FootContacts:
    """MuJoCo's contact parameters of some feet on the ground, one row a foot."""

    condim: np.ndarray
    friction: np.ndarray  # (feet, 3): sliding, torsional, rolling
    solref: np.ndarray  # (feet, 2)
    solimp: np.ndarray  # (feet, 5)


def foot_geoms(model: mujoco.MjModel, robot: Robot, location: str) -> np.ndarray:
    """Geoms of the feet at a location, by name: terrain and other parts shift the robot's own numbers."""
    return np.array([model.geom(robot.foot_geom_names[foot]).id for foot in robot.feet_at(location)], dtype=int)


def foot_contacts(robot: Robot, location: str) -> FootContacts:
    """Contact parameters of the feet at a location on the ground of the robot's model file."""
    model = robot.model
    mixed = [mixed_contact(model, int(foot)) for foot in robot.foot_geoms[robot.feet_at(location)]]
    return FootContacts(*(np.array(of_all) for of_all in zip(*mixed, strict=True)))


def mixed_contact(model: mujoco.MjModel, foot: int) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """Condim, friction, solref and solimp of a foot on the first part of the world that it can touch.

    The geom of higher priority decides; of equal ones MuJoCo takes the larger friction and condim and mixes the rest.
    """
    ground = ground_under(model, foot)
    if ground is None or model.geom_priority[foot] > model.geom_priority[ground]:
        return contact_of(model, foot)
    if model.geom_priority[foot] < model.geom_priority[ground]:
        return contact_of(model, ground)
    own, other = contact_of(model, foot), contact_of(model, ground)
    share = solver_mix(float(model.geom_solmix[foot]), float(model.geom_solmix[ground]))
    both_standard = own[2][0] > 0 and other[2][0] > 0
    solref = share * own[2] + (1 - share) * other[2] if both_standard else np.minimum(own[2], other[2])
    solimp = share * own[3] + (1 - share) * other[3]
    return max(own[0], other[0]), np.maximum(own[1], other[1]), solref, solimp


def ground_under(model: mujoco.MjModel, foot: int) -> int | None:
    """The first geom of the ground that a foot can touch; None where the model has no ground."""
    for geom in ground_geoms(model):
        contype, conaffinity = model.geom_contype, model.geom_conaffinity
        if contype[foot] & conaffinity[geom] or contype[geom] & conaffinity[foot]:
            return int(geom)
    return None


def contact_of(model: mujoco.MjModel, geom: int) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """Condim, friction, solref and solimp of one geom."""
    friction, solref, solimp = model.geom_friction[geom], model.geom_solref[geom], model.geom_solimp[geom]
    return int(model.geom_condim[geom]), friction.copy(), solref.copy(), solimp.copy()


def solver_mix(own: float, other: float) -> float:
    """Weight of the first geom when MuJoCo mixes by ``solmix``; it treats weights below 1e-15 as zero."""
    least = 1e-15
    if own >= least and other >= least:
        return own / (own + other)
    return 0.5 if own < least and other < least else float(own >= least)


def decide_contact(model: mujoco.MjModel, robot: Robot, location: str) -> None:
    """Give the feet at a location the highest priority, so that their own contact parameters hold on any ground.

    The parameters of the contacts stay as they are: a foot that did not have the highest priority gets the parameters
    that MuJoCo mixed for it.
    """
    feet = foot_geoms(model, robot, location)
    others = np.setdiff1d(np.arange(model.ngeom), foot_geoms(model, robot, "all"))
    highest = int(model.geom_priority[others].max(initial=-1))
    for foot in feet[model.geom_priority[feet] <= highest]:
        fields = (model.geom_condim, model.geom_friction, model.geom_solref, model.geom_solimp)
        for values, mixed in zip(fields, mixed_contact(model, int(foot)), strict=True):
            values[foot] = mixed
        model.geom_priority[foot] = highest + 1


@dataclass(frozen=True)
class ContactDamping(Effect):
    """Ratio of true to nominal damping of the feet's contacts (MuJoCo's ``solref``); their stiffness stays.

    MuJoCo lets no contact have a time constant below two steps, which bounds the damping of stiff feet.
    """

    name = "contact_damping"
    words = "contact damping of feet and ground"
    by_default = False
    places = "feet"

    scale: float = parameter(1.0, "1", 0.2, 5.0, 2.0, limits=(0.0, inf), logarithmic=True)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Scale the damping of the feet: in its form of time constant T and ratio ζ, T ζ is what stiffness has."""
        if self.is_nominal:
            return
        decide_contact(model, robot, self.location)
        for foot in foot_geoms(model, robot, self.location):
            if model.geom_solref[foot, 0] > 0:
                model.geom_solref[foot] *= (1 / self.scale, self.scale)
            else:
                model.geom_solref[foot, 1] *= self.scale


@dataclass(frozen=True)
class FootCompliance(Effect):
    """Time constant of the feet's contacts (MuJoCo's ``solref``), in place of the model's own; damping ratios stay.

    Where the model has feet of different time constants this is their mean, and each foot keeps its ratio to it.
    """

    name = "foot_compliance"
    words = "contact stiffness of feet and ground"
    places = "feet"

    time_constant_s: float | None = parameter(None, "s", 0.0, inf, limits=(0.0, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From a fifth of the model's own time constant to five times it."""
        own = mean_of(time_constants(foot_contacts(robot, location).solref))
        unit = cls.declarations()["time_constant_s"].unit
        return (Parameter("time_constant_s", unit, own, own / 5, 5 * own, 2 * own, own),)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Set the time constant of the feet."""
        if self.time_constant_s is None or self.is_nominal_for(robot):
            return
        solref = foot_contacts(robot, self.location).solref
        own = time_constants(solref)
        feet = foot_geoms(model, robot, self.location)
        decide_contact(model, robot, self.location)
        wanted = self.time_constant_s * (own / mean_of(own))
        direct = solref[:, 0] <= 0
        others = np.divide(model.geom_solref[feet], solref, out=np.ones_like(solref), where=solref != 0)  # have done
        model.geom_solref[feet[~direct], 0] = (wanted * others[:, 0])[~direct]
        ratio = (wanted / own)[direct]
        model.geom_solref[feet[direct]] = solref[direct] * others[direct] / np.column_stack([ratio**2, ratio])


def time_constants(solref: np.ndarray) -> np.ndarray:
    """Time constant of contacts, s, (places,), of ``solref`` (places, 2) in either of MuJoCo's two forms.

    The form of two negative numbers is −stiffness, −damping, and its time constant 2 / damping; without any damping
    it is that of critical damping, 1 / √stiffness.
    """
    stiffness, damping = np.maximum(-solref[:, 0], 1e-12), np.maximum(-solref[:, 1], 0.0)
    of_direct = np.where(damping > 0, 2 / np.maximum(damping, 1e-12), 1 / np.sqrt(stiffness))
    return np.where(solref[:, 0] > 0, solref[:, 0], of_direct)


@dataclass(frozen=True)
class FootFriction(Effect):
    """Coefficient of sliding friction between feet and ground, in place of the model's own.

    Where the model has feet of different friction this is their mean, and each foot keeps its ratio to it.
    """

    name = "foot_friction"
    words = "foot-ground friction coefficient"
    places = "feet"

    mu: float | None = parameter(None, "1", 0.2, 1.5, limits=(0.0, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From a quarter of the model's own friction to half as much again, and in any case from 0.2 to 1.5."""
        own = mean_of(foot_contacts(robot, location).friction[:, 0])
        about = cls.declarations()["mu"]
        lower, upper = min(about.lower, own / 4), max(about.upper, 1.5 * own)
        return (Parameter("mu", about.unit, own, lower, upper, own / 2, own),)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Set the friction of the feet."""
        if self.mu is None or self.is_nominal_for(robot):
            return
        own = foot_contacts(robot, self.location).friction[:, 0]
        feet = foot_geoms(model, robot, self.location)
        decide_contact(model, robot, self.location)
        model.geom_friction[feet, 0] = self.mu * (own / mean_of(own))


@dataclass(frozen=True)
class GroundHeight(Effect):
    """Extra height of the ground under the named feet, beyond the stated terrain; negative is a hole.

    The named feet stand on a copy of the whole ground, floor and boxes, that is raised and that nothing else touches;
    the other feet and the trunk stay on the stated one. So height, friction and lever arms are exact.
    """

    name = "ground_height"
    words = "ground height under the feet"
    places = "feet"

    height_m: float = parameter(0.0, "m", -0.08, 0.08, 0.03)

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Copy every geom of the ground that feet can touch, for collisions with the named feet alone."""
        used = 0
        for geom in spec.geoms:
            used |= int(geom.contype) | int(geom.conaffinity)
        own = 1 << used.bit_length()
        for i, geom in enumerate([g for g in ground_of_spec(spec) if touchable(g.contype, g.conaffinity, g.name)]):
            copy = geom.parent.add_geom()
            copy.name, copy.contype, copy.conaffinity, copy.group = f"{self._prefix}{i}", own, 0, geom.group
            for key in COPIED:
                setattr(copy, key, getattr(geom, key))
        for foot in robot.feet_at(self.location):
            spec.geom(robot.foot_geom_names[foot]).contype = 0
            spec.geom(robot.foot_geom_names[foot]).conaffinity = own

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Raise the copy of the ground by the height."""
        if self.is_nominal:
            return
        names = [model.geom(g).name for g in range(model.ngeom)]
        copies = [g for g, name in enumerate(names) if name.startswith(self._prefix)]
        contype, conaffinity = model.geom_contype, model.geom_conaffinity
        stated = [g for g in ground_geoms(model) if touchable(contype[g], conaffinity[g], names[g])]
        model.geom_pos[copies], model.geom_quat[copies] = model.geom_pos[stated], model.geom_quat[stated]
        model.geom_pos[copies, 2] += self.height_m
        model.geom_sameframe[copies] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)
        recompute_constants(model)

    @property
    def _prefix(self) -> str:
        return f"{COPY}{self.location}/"


COPY = "ground_height/"
COPIED = (
    *("type", "size", "pos", "quat", "alt", "fromto", "meshname", "hfieldname"),
    *("condim", "friction", "priority", "solref", "solimp", "solmix", "margin", "gap"),
)
"""Attributes that the raised ground copies from the stated one."""


def touchable(contype: int, conaffinity: int, name: str) -> bool:
    """Whether a geom of the world is stated ground: it collides and is not a copy."""
    return bool(contype or conaffinity) and not name.startswith(COPY)


@dataclass(frozen=True)
class GroundSlope(Effect):
    """The ground, with what stands on it, turned about the world's y axis through its origin; gravity stays vertical.

    Positive as a nose-down pitch: the ground falls away forward, x > 0.
    """

    name = "ground_slope"
    words = "ground slope"

    pitch_rad: float = parameter(0.0, "rad", -0.15, 0.15, 0.03)

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """A robot that is held needs ground in its model; one that floats may stand on the boxes of a log alone."""
        model = robot.model
        bodies = model.geom_bodyid.tolist()
        grounded = any(ground_under(model, geom) is not None for geom, body in enumerate(bodies) if body)
        return super().lacks(robot) or (None if robot.has_free_base or grounded else "ground")

    def on_model_ground(self) -> tuple[Effect, ...]:
        """A measuring frame that is turned as the ground is, and gravity that is turned back."""
        return FrameTilt(pitch_rad=self.pitch_rad), GravityDirection(pitch_rad=-self.pitch_rad)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Turn all geoms of the world, and the other bodies of the ground as a whole."""
        if self.is_nominal:
            return
        turn = np.array([np.cos(self.pitch_rad / 2), 0.0, np.sin(self.pitch_rad / 2), 0.0])
        roots = [body for body in ground_bodies(model)[1:] if model.body_parentid[body] == 0]
        of_world = np.flatnonzero(model.geom_bodyid == 0)
        for positions, turns, at in (
            *((model.geom_pos, model.geom_quat, geom) for geom in of_world),
            *((model.body_pos, model.body_quat, body) for body in roots),
        ):
            position, quaternion = np.empty(3), np.empty(4)
            mujoco.mju_rotVecQuat(position, positions[at], turn)
            mujoco.mju_mulQuat(quaternion, turn, turns[at])
            positions[at], turns[at] = position, quaternion
        model.geom_sameframe[of_world] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)
        recompute_constants(model)
