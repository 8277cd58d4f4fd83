"""Actuators and randomisation for mjlab."""

import re

from leapgap.export.actuators import PythonExport, missing_gains
from leapgap.export.base import CorrectedRobot, literal

SOURCE = '''\
"""A corrected robot for mjlab 1.6: put `actuators(dt)` into `EntityArticulationInfoCfg` and `EVENTS` among the events.

Use `robot.xml` without its own actuators. Numbers have SI units. `EVENTS` randomise each number over its 95 % interval
on its own; `posterior.npz` has correlated numbers, drawn together.
"""

from mjlab.actuator import IdealPdActuatorCfg
from mjlab.envs.mdp import dr
from mjlab.managers.event_manager import EventTermCfg
from mjlab.managers.scene_entity_config import SceneEntityCfg

{settings}RANGES = {ranges}
{steps}

def actuators(physics_dt):
    """The actuator of each joint, for a physics step in seconds."""
    found = []
    for joint, stiffness in STIFFNESS.items():
        least, largest = steps(DELAY_S[joint], physics_dt)
        limit = EFFORT_LIMIT[joint]
        found.append(
            IdealPdActuatorCfg(
                target_names_expr=(joint,),
                stiffness=stiffness,
                damping=DAMPING[joint],
                effort_limit=float("inf") if limit is None else limit,
                armature=ARMATURE[joint],
                frictionloss=FRICTION[joint],
                viscous_damping=VISCOUS_FRICTION[joint],
                delay_min_lag=least,
                delay_max_lag=largest,
                delay_update_period=10**9,  # one delay an episode
            )
        )
    return tuple(found)


def _events():
    """Terms for the identified numbers; masses and centres of mass are those of the link alone."""
    fields = {{
        "damping": dr.joint_damping,
        "friction": dr.joint_friction,
        "armature": dr.joint_armature,
        "mass": dr.body_mass,
        "foot_friction": dr.geom_friction,
    }}
    terms = {{}}
    for key, ranges in RANGES.items():
        if key in fields:
            params = {{"ranges": ranges, "operation": "abs", "asset_cfg": SceneEntityCfg("robot")}}
            if key == "foot_friction":
                params["axes"] = [0]
            terms[f"leapgap_{{key}}"] = EventTermCfg(mode="startup", func=fields[key], params=params)
        elif key.startswith("com_"):
            params = {{"ranges": ranges, "operation": "abs", "axes": ["xyz".index(key[-1])]}}
            params["asset_cfg"] = SceneEntityCfg("robot")
            terms[f"leapgap_{{key}}"] = EventTermCfg(mode="startup", func=dr.body_com_offset, params=params)
        elif key == "encoder_bias_rad":
            for joint, (low, high) in ranges.items():
                params = {{"bias_range": (low, high), "asset_cfg": SceneEntityCfg("robot", joint_names=(joint,))}}
                term = EventTermCfg(mode="startup", func=dr.encoder_bias, params=params)
                terms[f"leapgap_encoder_bias_{{joint}}"] = term
    return terms


EVENTS = _events()
'''


class Mjlab(PythonExport):
    """Actuators and events for mjlab, as Python."""

    name = "for_mjlab.py"
    says = "actuators with delay, friction and armature, and events, for mjlab 1.6"
    source = SOURCE

    def lacks(self, corrected: CorrectedRobot) -> str | None:
        """The gains of the joint PD, where no log has them."""
        return missing_gains(corrected)

    def further(self, corrected: CorrectedRobot) -> dict[str, str]:
        """Ranges of joints, bodies and feet."""
        of = corrected.ranges
        ranges = of["joints"] | of["bodies"] | {f"foot_{key}": own for key, own in of["feet"].items()}
        plain = {key: {re.escape(name): (one.low, one.high) for name, one in of.items()} for key, of in ranges.items()}
        return {"ranges": literal(plain)}
