"""A two-link arm with what a test asks of its motors and its elbow."""

from pathlib import Path

from leapgap.robot.model import Robot

ARM = """
<mujoco model="arm">
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="upper"><joint name="L_shoulder" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="1"/>
      <body name="lower" pos="0.3 0 0"><joint name="L_elbow" axis="0 1 0" damping="0.1"{elbow}/>
        <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.02" mass="0.6"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    {shoulder_motor}
    {elbow_motor}
  </actuator>
</mujoco>
"""
TORQUE_MOTOR = '<motor joint="{joint}" ctrlrange="-40 40" forcerange="-40 40"/>'
SERVO = '<general joint="{joint}" biastype="affine" biasprm="0 -60 -1"/>'
"""Pulls with 60 N·m/rad to zero, against 1 N·m·s/rad; its control is a further torque, N·m."""


def two_link_arm(motor: str, elbow: str = "") -> str:
    """MJCF of the arm: ``motor`` is one of the above, ``elbow`` further attributes of the elbow's joint."""
    motors = {f"{name}_motor": motor.format(joint=f"L_{name}") for name in ("shoulder", "elbow")}
    return ARM.format(elbow=elbow, **motors)


def torque_driven_arm(folder: Path) -> Robot:
    """The arm with torque motors, its model written into a folder."""
    path = folder / "arm.xml"
    path.write_text(two_link_arm(TORQUE_MOTOR))
    return Robot.load(path)
