"""Ground height under the feet."""

from dataclasses import dataclass

import mujoco

from leapgap.effects.base import Effect, parameter, recompute_constants
from leapgap.robot.model import Robot
from leapgap.robot.terrain import ground_geoms, ground_of_spec


@dataclass(frozen=True)
class GroundHeight(Effect):
    """Extra height of the ground under the named feet, beyond the stated terrain; negative is a hole.

    The named feet stand on a copy of the whole ground, floor and boxes, that is raised and that nothing else touches;
    the other feet and the trunk stay on the stated one. So height, friction and lever arms are exact.
    """

    name = "ground_height"
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
