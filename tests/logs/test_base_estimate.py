"""The base of a robot that jumps where gravity is another, by plain MuJoCo, against its estimate from the foot."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.logs.log import Log, LogInfo
from leapgap.logs.state import States
from leapgap.robot.model import Robot
from leapgap.robot.topology import PartNames

STEP_S, STANDS, ROWS = 0.002, 150, 750
"""Time step, rows before the leg is stretched, and all rows."""
KP, KD = 3000.0, 60.0
POGO = """
<mujoco model="pogo">
  <option gravity="{gravity}" timestep="0.002"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1" friction="1 .1 .1"/>
    <body name="trunk" pos="0 0 0.5">
      <freejoint/>
      <geom type="box" size=".1 .1 .05" mass="5"/>
      <body name="foot" pos="0 0 -0.45">
        <joint name="leg" type="slide" axis="0 0 -1" range="-.2 .2"/>
        <geom name="sole" type="box" size=".15 .15 .05" mass=".1"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="leg" ctrlrange="-400 400"/></actuator>
</mujoco>
"""


def jump(folder: Path, gravity: tuple[float, ...], push_m: float) -> tuple[Log, np.ndarray, np.ndarray, Robot]:
    """The leg is stretched once: a log without place and velocity of the base, these two, and the robot.

    Place and velocity are (rows, 3) each, m and m/s.
    """
    (path := folder / "pogo.xml").write_text(POGO.format(gravity=" ".join(map(str, gravity))))
    model = mujoco.MjModel.from_xml_path(str(path))
    data, rows = mujoco.MjData(model), ROWS
    names = [*(f"base_quat_{a}" for a in "wxyz"), *(f"base_angvel_{a}" for a in "xyz")]
    names += [f"{of}/leg" for of in ("joint_pos", "joint_vel", "cmd_pos", "cmd_vel", "cmd_tau", "cmd_kp", "cmd_kd")]
    columns = {name: np.zeros(rows) for name in ("time", *names, "contact/sole")}
    place, velocity = np.empty((rows, 3)), np.empty((rows, 3))
    for row in range(rows):
        mujoco.mj_forward(model, data)
        wanted = push_m if row > STANDS else 0.0
        values = [*data.qpos[3:7], *data.qvel[3:6], data.qpos[7], data.qvel[6], wanted, 0.0, 0.0, KP, KD]
        for name, value in zip(names, values, strict=True):
            columns[name][row] = value
        columns["time"][row], columns["contact/sole"][row] = row * STEP_S, data.ncon > 0
        place[row], velocity[row] = data.qpos[:3], data.qvel[:3]
        data.ctrl[:] = KP * (wanted - data.qpos[7]) - KD * data.qvel[6]
        mujoco.mj_step(model, data)
    log = Log("jump", columns, LogInfo("pogo", STEP_S, "plain MuJoCo"))
    return log, place, velocity, Robot.load(path, names=PartNames(feet=("sole",)))


def first_flight(log: Log) -> slice:
    """Rows of the first flight after the stance, but its first and last ten."""
    flies = np.append(log["contact/sole"] == 0, False)
    begin = STANDS + int(np.argmax(flies[STANDS:]))
    return slice(begin + 10, begin + int(np.argmin(flies[begin:])) - 10)


@pytest.mark.parametrize(
    ("gravity", "push_m"), [((0.0, 0.0, -1.62), 0.02), ((0.0, 0.0, -20.0), 0.1), ((0.4, -0.2, -1.62), 0.02)]
)
def test_a_flight_between_two_stances_is_an_arc_of_the_models_gravity(
    gravity: tuple[float, ...], push_m: float, tmp_path: Path
) -> None:
    log, place, velocity, robot = jump(tmp_path, gravity, push_m)
    flight = first_flight(log)
    found = States.of(log, robot).base
    assert found is not None and np.ptp(place[flight, 2]) > 0.005
    assert np.abs(found.position - place)[flight, 2].max() < 0.002
    assert np.abs(found.velocity - velocity)[flight, 2].max() < 0.03


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -1.62), (0.0, 0.0, -20.0), (0.4, -0.2, -1.62)])
def test_a_flight_with_which_the_log_ends_falls_with_the_models_gravity(
    gravity: tuple[float, ...], tmp_path: Path
) -> None:
    """How fast it begins is known to the speed of the foot alone; how it goes on is not a matter of the foot."""
    log, *_, robot = jump(tmp_path, gravity, 0.1 if gravity[2] < -10 else 0.02)
    flight = first_flight(log)
    found = States.of(log.first_rows(flight.stop), robot).base
    assert found is not None
    assert np.diff(found.velocity[flight], axis=0) / STEP_S == pytest.approx(
        np.tile(gravity, (flight.stop - flight.start - 1, 1))
    )
    rises = np.diff(found.position[flight, 2], 2) / STEP_S**2
    assert rises == pytest.approx(np.full(len(rises), gravity[2]), rel=1e-6)
