"""What generated Python imports, by the documented names and fields of each simulator, for where it is not installed.

Read from the sources of mjlab 1.6.0, Isaac Lab 2.3.2, PACE 0.2 and MuJoCo Playground 0.2.0 with MJX 3.x. A field or an
argument that is not theirs is a ``TypeError``.
"""

import inspect
import sys
import types
from collections.abc import Callable
from dataclasses import make_dataclass
from pathlib import Path
from typing import Any

import pytest

MJLAB_PD = {
    *("target_names_expr", "transmission_type", "armature", "frictionloss", "viscous_damping", "delay_min_lag"),
    *("delay_max_lag", "delay_hold_prob", "delay_update_period", "delay_per_env_phase"),
    *("stiffness", "damping", "effort_limit"),
}
MJLAB_DR = {"env", "env_ids", "ranges", "asset_cfg", "distribution", "operation", "axes", "shared_random"}
ISAAC_BASE = {
    *("class_type", "joint_names_expr", "effort_limit", "velocity_limit", "effort_limit_sim", "velocity_limit_sim"),
    *("stiffness", "damping", "armature", "friction", "dynamic_friction", "viscous_friction"),
}
NETWORK = {"network_file", "pos_scale", "vel_scale", "torque_scale", "input_order"}
LEARNED = {
    "LearnedMlpActuatorCfg": {*MJLAB_PD, *NETWORK, "saturation_effort", "velocity_limit", "history_length"},
    "ActuatorNetMLPCfg": {*ISAAC_BASE, *NETWORK, "saturation_effort", "input_idx"},
}
"""Both take errors of the set point, then velocities, the newest first (0: the current step), each times its scale."""
ISAAC_TERM = {*("func", "mode", "params", "interval_range_s", "is_global_time", "min_step_count_between_reset")}
ISAAC_MASS = {"env", "env_ids", "asset_cfg", "mass_distribution_params", "operation", "distribution"}


def record(name: str, allowed: set[str]) -> type:
    """A class that takes the documented fields by keyword and no other."""
    return make_dataclass(name, [(one, Any, None) for one in sorted(allowed)], kw_only=True)


def takes(name: str, allowed: set[str]) -> Callable[..., None]:
    """A function with the documented arguments."""

    def function(**given: Any) -> None:
        raise AssertionError("the environment calls it")

    parameters = [inspect.Parameter(one, inspect.Parameter.KEYWORD_ONLY) for one in sorted(allowed)]
    function.__name__ = name
    function.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return function


class SceneEntityCfg:
    """Of both, with the fields that are used."""

    def __init__(self, name: str, joint_names: Any = None, body_names: Any = None) -> None:
        self.name, self.joint_names, self.body_names = name, joint_names, body_names


def mjlab() -> dict[str, dict[str, Any]]:
    dr = dict.fromkeys(("joint_damping", "joint_friction", "joint_armature", "body_mass", "body_com_offset"), MJLAB_DR)
    dr |= {"geom_friction": MJLAB_DR, "encoder_bias": {"env", "env_ids", "bias_range", "asset_cfg"}}
    functions = types.SimpleNamespace(**{name: takes(name, allowed) for name, allowed in dr.items()})
    return {
        "mjlab.actuator": {"IdealPdActuatorCfg": record("IdealPdActuatorCfg", MJLAB_PD)},
        "mjlab.envs.mdp": {"dr": functions},
        "mjlab.managers.event_manager": {"EventTermCfg": record("EventTermCfg", ISAAC_TERM)},
        "mjlab.managers.scene_entity_config": {"SceneEntityCfg": SceneEntityCfg},
    }


def isaac_lab() -> dict[str, dict[str, Any]]:
    mdp = types.SimpleNamespace(
        randomize_rigid_body_mass=takes("randomize_rigid_body_mass", ISAAC_MASS | {"recompute_inertia", "min_mass"}),
        randomize_rigid_body_com=takes("randomize_rigid_body_com", {"env", "env_ids", "com_range", "asset_cfg"}),
    )
    delayed = record("DelayedPDActuatorCfg", ISAAC_BASE | {"min_delay", "max_delay"})
    return {
        "isaaclab.actuators": {"DelayedPDActuatorCfg": delayed},
        "isaaclab.envs": {"mdp": mdp},
        "isaaclab.managers": {"EventTermCfg": record("EventTermCfg", ISAAC_TERM), "SceneEntityCfg": SceneEntityCfg},
    }


def pace() -> dict[str, dict[str, Any]]:
    motor = record("PaceDCMotorCfg", ISAAC_BASE | {"saturation_effort", "encoder_bias", "max_delay"})
    return {"pace_sim2real.utils": {"PaceDCMotorCfg": motor}}


def run(path: Path, modules: dict[str, dict[str, Any]], monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Names of a generated file that is run with these modules in place of those of its simulator."""
    for name, content in modules.items():
        parts = name.split(".")
        for end in range(1, len(parts) + 1):
            above = ".".join(parts[:end])
            if above not in sys.modules or end == len(parts):
                monkeypatch.setitem(sys.modules, above, types.ModuleType(above))
        for key, value in content.items():
            setattr(sys.modules[name], key, value)
    names: dict[str, Any] = {"__file__": str(path), "__name__": path.stem}
    exec(compile(path.read_text(), str(path), "exec"), names)
    return names


def accepts(term: Any) -> None:
    """Assert that the function of an event has the arguments that the event gives it."""
    arguments = inspect.signature(term.func).parameters
    unknown = set(term.params) - set(arguments)
    assert not unknown, f"{term.func.__name__} has no {unknown}"
