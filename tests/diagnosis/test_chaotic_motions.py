"""A right answer looks right on motions that nobody can foretell over a whole log, by plain MuJoCo."""

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.settings import Settings
from leapgap.logs.log import Log, LogInfo
from leapgap.robot.model import Robot

ARMS, STEP_S, ROWS, KP, KD = 14, 0.002, 4000, 30.0, 1.0
ARM = """<body pos="0 {y} 1"><joint name="{name}" axis="0 1 0" damping="0.1"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>{tail}</body>"""
TAIL = """<body pos="0 0 -0.3"><joint name="tail" axis="0 1 0" frictionloss="{friction}"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.015" mass="0.2"/></body>"""
ROBOT = """<mujoco model="arms_with_a_tail"><option timestep="0.002"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>{arms}</worldbody><actuator>{motors}</actuator></mujoco>"""


def xml(friction: float) -> str:
    """Fourteen arms with a motor each; the last one swings a tail, which turns over as it likes where nothing rubs."""
    arms = [
        ARM.format(y=k / 5, name=f"arm_{k}", tail=TAIL.format(friction=friction) if k == ARMS - 1 else "")
        for k in range(ARMS)
    ]
    motors = "".join(f'<motor joint="arm_{k}" ctrlrange="-30 30"/>' for k in range(ARMS))
    return ROBOT.format(arms="".join(arms), motors=motors)


def swing(seed: int, friction: float) -> Log:
    """One log of 8 s."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(xml(friction))
    data = mujoco.MjData(model)
    names = [model.joint(j).name for j in range(model.njnt)]
    time = np.arange(ROWS) * STEP_S
    wanted = rng.uniform(0.9, 1.3, ARMS) * np.sin(2 * np.pi * rng.uniform(0.8, 1.2, ARMS) * time[:, None])
    qpos, qvel = np.empty((ROWS, ARMS + 1)), np.empty((ROWS, ARMS + 1))
    for row in range(ROWS):
        qpos[row], qvel[row] = data.qpos, data.qvel
        data.ctrl[:] = KP * (wanted[row] - data.qpos[:ARMS]) - KD * data.qvel[:ARMS]
        mujoco.mj_step(model, data)
    columns = {"time": time}
    for j, name in enumerate(names):
        columns[f"joint_pos/{name}"] = qpos[:, j] + 3e-3 * rng.standard_normal(ROWS)
        columns[f"joint_vel/{name}"] = qvel[:, j] + 3e-2 * rng.standard_normal(ROWS)
    for j, name in enumerate(names[:ARMS]):
        sent = {"cmd_tau": 0 * time, "cmd_pos": wanted[:, j], "cmd_vel": 0 * time, "cmd_kp": KP + 0 * time}
        columns |= {f"{quantity}/{name}": values for quantity, values in (sent | {"cmd_kd": KD + 0 * time}).items()}
    return Log(f"swing_{seed}", columns, LogInfo("arms", STEP_S, "plain MuJoCo"))


@pytest.fixture(scope="module")
def arms(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    path = tmp_path_factory.mktemp("arms") / "arms.xml"
    path.write_text(xml(friction=0.1))
    return Robot.load(path)


SETTINGS = Settings(
    effects=["joint_friction"],
    folds=2,
    pieces_per_log=8,
    bootstrap_draws=50,
)


@pytest.mark.long
def test_a_right_answer_is_judged_over_the_time_it_can_be_foretold(arms: Robot) -> None:
    """The model brakes the tail, the robot does not: with the friction taken away the whole log is chaotic."""
    report = diagnose([swing(seed, friction=0.0) for seed in range(3)], arms, SETTINGS).report
    assert report.answer == (("joint_friction",),), report.sentence
    assert report.causes[0].parameters["torque_nm"].value == pytest.approx(-0.1, abs=0.01)
    assert report.closure_of_answer.value > 0.7
    assert report.headline.horizon_s is not None
