"""Actuators and randomisation for Isaac Lab."""

import re
from typing import Any

from leapgap.export.actuators import PythonExport
from leapgap.export.base import CorrectedRobot, literal

SOURCE = '''\
"""A corrected robot for Isaac Lab 2.3 (Isaac Sim 5, where joint friction is a torque).

Put `actuators(dt)` into `ArticulationCfg(actuators=...)` and the terms of `EVENTS` into the class of events. Numbers
have SI units. Joints are drawn together from `posterior.npz`, which must lie beside this file; masses and centres of
mass are drawn over their 95 % intervals, for an asset made from `urdf/` or `robot.xml`. Isaac Lab's own
`randomize_joint_parameters` draws viscous friction from the range of dry friction, so it is not used.

There is no `DriveBam` here: it needs the voltage, the winding and the firmware's gain of a servo, which logs of joints
do not tell.
"""

from pathlib import Path

import numpy as np
import torch
from isaaclab.actuators import DelayedPDActuatorCfg
from isaaclab.envs import mdp
from isaaclab.managers import EventTermCfg, SceneEntityCfg

{settings}BODY_RANGES = {ranges}
VARIES = {varies}
{steps}

def actuators(physics_dt):
    """Actuators by groups of joints with equal delays, for a physics step in seconds."""
    groups = {{}}
    for joint, delay_s in DELAY_S.items():
        groups.setdefault(steps(delay_s, physics_dt), []).append(joint)

    def of(values, joints):
        return {{joint: values[joint] for joint in joints if values[joint] is not None}} or None

    return {{
        f"delayed_{{least}}_{{largest}}": DelayedPDActuatorCfg(
            joint_names_expr=joints,
            stiffness=of(STIFFNESS, joints),
            damping=of(DAMPING, joints),
            effort_limit=of(EFFORT_LIMIT, joints),
            armature=of(ARMATURE, joints),
            friction=of(FRICTION, joints),
            dynamic_friction=of(FRICTION, joints),
            viscous_friction=of(VISCOUS_FRICTION, joints),
            min_delay=least,
            max_delay=largest,
        )
        for (least, largest), joints in groups.items()
    }}


def joints_drawn_together(env, env_ids, asset_cfg, samples):
    """Give each environment the friction, damping and armature of one robot of the posterior."""
    asset = env.scene[asset_cfg.name]
    with np.load(samples) as file:
        table = {{key: file[key] for key in ("joints", "friction", "damping", "armature")}}
    names = [name for name in table["joints"].tolist() if name in asset.joint_names]
    ids = [asset.joint_names.index(name) for name in names]
    columns = [table["joints"].tolist().index(name) for name in names]
    if env_ids is None:
        env_ids = torch.arange(env.scene.num_envs, device=asset.device)
    rows = torch.randint(len(table["friction"]), (len(env_ids),)).numpy()
    friction, viscous, armature = (
        torch.tensor(table[key][np.ix_(rows, columns)], dtype=torch.float32, device=asset.device)
        for key in ("friction", "damping", "armature")
    )
    asset.write_joint_friction_coefficient_to_sim(
        joint_friction_coeff=friction,
        joint_dynamic_friction_coeff=friction,
        joint_viscous_friction_coeff=viscous,
        joint_ids=ids,
        env_ids=env_ids,
    )
    asset.write_joint_armature_to_sim(armature, joint_ids=ids, env_ids=env_ids)


def _events():
    """Terms for the identified numbers."""
    terms = {{}}
    if VARIES:
        params = {{"asset_cfg": SceneEntityCfg("robot"), "samples": str(Path(__file__).with_name("posterior.npz"))}}
        terms["leapgap_joints"] = EventTermCfg(func=joints_drawn_together, mode="startup", params=params)
    for body, of in BODY_RANGES.items():
        at = SceneEntityCfg("robot", body_names=[body])
        if "mass" in of:
            params = {{"asset_cfg": at, "mass_distribution_params": of["mass"], "operation": "abs"}}
            term = EventTermCfg(func=mdp.randomize_rigid_body_mass, mode="startup", params=params)
            terms[f"leapgap_mass_{{body}}"] = term
        if "com" in of:
            params = {{"asset_cfg": at, "com_range": of["com"]}}
            term = EventTermCfg(func=mdp.randomize_rigid_body_com, mode="startup", params=params)
            terms[f"leapgap_com_{{body}}"] = term
    return terms


EVENTS = _events()
'''


class IsaacLab(PythonExport):
    """Actuators and events for Isaac Lab, as Python."""

    name = "for_isaac_lab.py"
    says = "actuators (`DelayedPDActuatorCfg`) and events for Isaac Lab 2.3"
    source = SOURCE

    def further(self, corrected: CorrectedRobot) -> dict[str, str]:
        """Ranges of bodies, and which numbers of joints vary."""
        varies = [key for key in ("damping", "friction", "armature") if key in corrected.ranges["joints"]]
        # Body → ``mass``, kg, and ``com``: axis → how far the centre of mass is from that of the corrected robot, m
        found: dict[str, dict[str, Any]] = {}
        for key, of in corrected.ranges["bodies"].items():
            for body, one in of.items():
                own = found.setdefault(re.escape(body), {})
                if key == "mass":
                    own["mass"] = (one.low, one.high)
                else:
                    own.setdefault("com", {})[key[-1]] = (one.low - one.value, one.high - one.value)
        return {"ranges": literal(found), "varies": literal(varies)}
