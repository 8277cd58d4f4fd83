"""How long a robot stands before it jumps: until it is still, and no longer than it must."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from leapgap.jumping.experiments.goal_directed_jump import JumpPlanner, Stand
from leapgap.jumping.experiments.method import AimingMethod, JumpTask
from leapgap.jumping.experiments.rig import Bench
from leapgap.jumping.experiments.trial import attempt_task
from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.models.rigid_body import PITCH_RATE, VX
from leapgap.logs.log import read_log, write_log
from leapgap.simulation.controller import StateEstimate
from leapgap.simulation.sensors import SensorNoise
from tests.jumping.control.simple_models import estimate

PERIOD_S = 0.001


def jumps_after_s(stand: Stand, velocity: np.ndarray, pitch_rate: np.ndarray, yaw: float = 0.0) -> float:
    """Time that a robot stands whose base moves so forward, m/s, and turns so, rad/s, (ticks,) each."""
    noise, rng = SensorNoise(), np.random.default_rng(0)
    seen: list[StateEstimate] = []
    for tick, (v, rate) in enumerate(zip(velocity, pitch_rate, strict=True)):
        state = np.zeros(6)
        state[VX], state[PITCH_RATE] = v, rate
        true = estimate(tick * PERIOD_S, state, yaw=yaw)
        seen.append(
            replace(
                true,
                base_velocity=true.base_velocity + noise.base_linvel_m_s * rng.standard_normal(3),
                base_angular_velocity=true.base_angular_velocity + noise.base_angvel_rad_s * rng.standard_normal(3),
            )
        )
        if stand.is_over(seen):
            return tick * PERIOD_S
    raise AssertionError("never")


def test_a_still_robot_stands_as_long_as_its_stance_is_measured() -> None:
    still = np.zeros(600)
    assert jumps_after_s(Stand(), still, still) == pytest.approx(Stand().measured_s)


@pytest.mark.parametrize("yaw", [0.0, 1.6])
def test_a_robot_that_swings_waits_until_it_has_come_to_rest(yaw: float) -> None:
    """It turns back every 100 ms, and is slow for a moment then; after 300 ms less than the limits is left."""
    times = PERIOD_S * np.arange(600)
    swing = np.exp(-times / 0.08) * np.cos(np.pi * times / 0.1)
    assert 0.2 < jumps_after_s(Stand(), 0.3 * swing, 1.5 * swing, yaw) < 0.4
    assert 0.2 < jumps_after_s(Stand(), 0.3 * swing, 0 * swing, yaw) < 0.35


def test_a_robot_that_never_comes_to_rest_jumps_all_the_same() -> None:
    sways = 0.1 * np.cos(20 * PERIOD_S * np.arange(600))
    assert jumps_after_s(Stand(), sways, 0 * sways) == pytest.approx(Stand().longest_s)


def test_a_wrong_crouch_is_stood_out_before_the_jump(bench: Bench) -> None:
    """The joints are up to 0.1 rad off at the start; the base moves slower than the limits when the jump begins."""
    method = AimingMethod(bench.robot, bench.references, planner=JumpPlanner(planar_robot(bench.robot)))
    found = {
        task.name: attempt_task(task, method, bench.level, (), bench.world, np.random.default_rng(1))
        for task in (JumpTask("calm", 0.5), JumpTask("crouch", 0.5, crouch_error_rad=0.1))
    }
    assert found["calm"].starts[0] == 60
    first = found["crouch"].starts[0]
    assert 100 < first <= 400
    moving = np.abs(found["crouch"].run.truth.qvel[: first + 1, :3]).max(axis=1)
    assert moving[:60].max() > 0.1 and moving[first - 20 :].max() < 0.03
    apart_cm = found["crouch"].landings[0].error_cm - found["calm"].landings[0].error_cm
    assert abs(apart_cm) < 2.0


def test_the_log_says_when_its_jump_began(bench: Bench, tmp_path: Path) -> None:
    """Its planned phases begin with the jump, in a file too; the front feet push until they are to leave the ground."""
    method = AimingMethod(bench.robot, bench.references, planner=JumpPlanner(planar_robot(bench.robot)))
    task = JumpTask("crouch", 0.5, crouch_error_rad=0.1)
    found = attempt_task(task, method, bench.level, (), bench.world, np.random.default_rng(1))
    write_log(found.run.log, tmp_path / "crouch.parquet")
    log, begin_s = read_log(tmp_path / "crouch.parquet"), found.starts[0] * PERIOD_S
    begins = {one.name: one.begin_s for one in log.info.segments}
    assert begins == pytest.approx(
        {"stand": 0, "double_contact": begin_s, "rear_contact": begin_s + 0.5, "lift_off": begin_s + 0.75}
        | {"flight": begin_s + 0.85, "touch_down": begin_s + 1.2}
    )
    pushes = np.flatnonzero(log["pd_force/front_z"])
    assert pushes[-1] == found.starts[0] + 499
