"""How exactly a robot is known: shares of its own numbers, whatever robot it is."""

from pathlib import Path

import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.candidates import nominal_candidate
from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.experiment_forecast import errors_of, with_nuisances
from leapgap.diagnosis.hypotheses import Hypothesis, places, tolerance
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.settings import Settings
from leapgap.diagnosis.short_rollouts import ShortRollouts
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.sensors import SensorNoise
from tests.conftest import standing
from tests.diagnosis.test_gap import hardware

OF_THE_A1 = {
    "armature.inertia": 0.0005,  # kg·m²
    "joint_friction.torque_nm": 0.01,  # N·m
    "joint_damping.damping": 0.001,  # N·m·s/rad
    "foot_friction.mu": 0.016,
    "foot_compliance.time_constant_s": 0.0006,  # s
    "leg_mass.scale": 0.005,
    "com_offset.x_m": 0.0005,  # m
    "com_offset.z_m": 0.0005,  # m
    "payload.mass_kg": 0.023565,  # kg, 0.5 % of a trunk of 4.713 kg
    "trunk_inertia.scale": 0.005,
}


def at_every_place(name: str, robot: Robot) -> list[float]:
    """A tolerance in the parameter's unit, at each joint or foot of a robot."""
    effect, _, parameter = name.partition(".")
    kind = effects.known()[effect]
    share = Settings().tolerances[name]
    return [tolerance(kind, robot, place, parameter, share) for place in places(kind, robot)["all"]]


def test_shares_are_the_tolerances_that_were_validated_on_the_a1(robot: Robot) -> None:
    assert Settings().tolerances.keys() == OF_THE_A1.keys()
    for name, value in OF_THE_A1.items():
        assert at_every_place(name, robot) == pytest.approx([value] * len(at_every_place(name, robot)), rel=1e-12), name


def test_a_robot_with_other_numbers_has_other_tolerances(robot: Robot, tmp_path: Path) -> None:
    """Twice the friction at the feet, a stiff gear at one joint, and no armature: the shares stay."""
    text = robot.path.read_text(encoding="utf-8").replace('armature="0.01"', 'armature="0"')
    assert text != robot.path.read_text(encoding="utf-8")
    (tmp_path / "other.xml").write_text(text, encoding="utf-8")
    other = Robot.load(tmp_path / "other.xml")
    assert set(at_every_place("armature.inertia", other)) == {0.0}
    other.model.dof_damping[other.joint_dofs[3]] = 2.0
    assert at_every_place("joint_damping.damping", other)[2:5] == pytest.approx([0.001, 0.2, 0.001])


@pytest.mark.parametrize("name", ["armature.inertai", "armature", "rust.share"])
def test_a_tolerance_of_nothing_is_refused(robot: Robot, name: str) -> None:
    with pytest.raises(InputError, match=f"tolerances: found {name}; expected <effect>.<parameter>"):
        diagnose([standing(robot, 50)] * 2, robot, Settings(tolerances={name: 0.1}))


def test_a_nuisance_is_one_tolerance_of_a_change_of_its_place(robot: Robot, reference: Log) -> None:
    jumps = hardware(robot, reference, noise=SensorNoise(), jumps=2)
    evidence = ShortRollouts.of(JudgedLogs.of(jumps, robot).states, Replayer(robot, terrain_slots=1), 0.1, 0.01, 4)
    shares = {"payload.mass_kg": 0.01, "foot_friction.mu": 0.02}
    short, columns = with_nuisances(evidence, nominal_candidate(2), shares)
    assert columns.shape[2] == 1 + 1 + len(robot.feet)  # the first is the error of the steps
    at = [
        ("payload", "all", "mass_kg", 0.01 * 4.713),
        *(("foot_friction", foot, "mu", 0.02 * 0.8) for foot in robot.feet),
    ]
    for number, (name, place, parameter, size) in enumerate(at):
        there = Hypothesis(effects.known()[name], robot, place)
        (value,), (by,) = there.nominal + there.moderate, there.moderate
        start, changed = errors_of(short, [(), (effects.effect(name, location=place, **{parameter: value}),)])
        assert np.abs(changed - start).max() > 0
        assert columns[:, :, 1 + number] == pytest.approx(size / by * (changed - start))
