"""Settings of the actuators as simulators with joint PDs of their own take them, by joint."""

import re
from abc import abstractmethod
from math import isfinite
from pathlib import Path
from typing import Any, ClassVar

from leapgap.export.base import CorrectedRobot, Export, literal
from leapgap.runtime.atomic_io import write_text


def actuator_settings(corrected: CorrectedRobot) -> dict[str, dict[str, Any]]:
    """Settings of the actuators of the driven joints, SI units, by joint, which keeps the order of the model.

    ``stiffness`` and ``damping`` are gains of the joint PD times what a motor delivers of a torque, None where no log
    has them; ``effort_limit`` is None where the model states none; ``delay_s`` is the least and the largest delay of
    commands, by the 95 % interval; what is added to observed joint positions is ``encoder_bias``, reported − true.
    """
    robot, numbers = corrected.robot, corrected.corrected
    driven = [(i, joint) for i, joint in enumerate(robot.joints) if robot.driven[i]]

    def by_joint(key: str) -> dict[str, float]:
        return {joint: float(numbers[key][i]) for i, joint in driven}

    def delivered(entry: int, scale: dict[str, float]) -> dict[str, float | None]:
        return {joint: gains[joint][entry] * gain[joint] * scale[joint] if joint in gains else None for joint in gain}

    gain, gains = by_joint("torque_gain"), corrected.gains
    limits, delay = by_joint("torque_limit"), by_joint("command_delay_s")
    ranges = corrected.ranges["joints"].get("command_delay_s", {})
    return {
        "stiffness": delivered(0, by_joint("position_gain")),
        "damping": delivered(1, by_joint("velocity_gain")),
        "effort_limit": {joint: limit if isfinite(limit) else None for joint, limit in limits.items()},
        "armature": by_joint("armature"),
        "friction": by_joint("friction"),
        "viscous_friction": by_joint("damping"),
        "encoder_bias": by_joint("encoder_bias_rad"),
        "delay_s": {
            joint: (ranges[joint].low, ranges[joint].high) if joint in ranges else (own, own)
            for joint, own in delay.items()
        },
    }


def missing_gains(corrected: CorrectedRobot) -> str | None:
    """What no log says of the joint PD; None where the gains are known."""
    unknown = [joint for joint in corrected.robot.driven_joints if joint not in corrected.gains]
    return f"no log has the gains of {', '.join(unknown)}" if unknown else None


STEPS = '''
def steps(delay_s, physics_dt):
    """Least and largest delay in physics steps, to whole steps; the range is that of the identified delay."""
    low, high = delay_s
    return round(low / physics_dt), round(high / physics_dt)
'''
"""Source of a function that the files share."""


class PythonExport(Export):
    """A file of Python with the settings of the actuators."""

    source: ClassVar[str]  # its text, with ``settings``, ``steps`` and what is ``further`` in braces

    @abstractmethod
    def further(self, corrected: CorrectedRobot) -> dict[str, str]:
        """What else is in the text, by name."""

    def write(self, folder: Path, corrected: CorrectedRobot) -> None:
        """Write the Python file."""
        # Simulators take the joints' names as expressions
        values = {
            key: {re.escape(joint): value for joint, value in of.items()}
            for key, of in actuator_settings(corrected).items()
        }
        says = {"encoder_bias": "reported - true: add it to observed joint positions", "delay_s": "least and largest"}
        lines = [f"# {key.upper()}: {words}\n" for key, words in says.items()]
        settings = "".join([*lines, *(f"{key.upper()} = {literal(of)}\n" for key, of in values.items())])
        write_text(folder / self.name, self.source.format(settings=settings, steps=STEPS, **self.further(corrected)))
