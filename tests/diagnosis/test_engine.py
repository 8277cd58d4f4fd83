"""The engine beside references of its own: dense Gaussians, plain MuJoCo, and arms that plain MuJoCo simulates."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.stats import multivariate_normal

from leapgap import effects
from leapgap.diagnosis.diagnose import Diagnosis, diagnose
from leapgap.diagnosis.engine.evidence import Blocks, Evidence, posterior_of
from leapgap.diagnosis.engine.intervals import Course, Intervals
from leapgap.diagnosis.engine.points import otherwise_integrated
from leapgap.diagnosis.engine.responses import Columns, Displacements
from leapgap.diagnosis.engine.search import Found, left_unnamed, lost_in_range
from leapgap.diagnosis.engine.whitening import CORRELATION_S, Chunks, Filter, linearise, touching
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.settings import Settings
from leapgap.logs.log import read_logs
from leapgap.robot.model import DEFAULT_MODEL, Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer
from tests import plain_arm
from tests.diagnosis import pd_arms


def test_evidence_and_posterior_are_those_of_a_dense_gaussian() -> None:
    """Of ten errors by two columns with priors about other means than zero."""
    rng = np.random.default_rng(3)
    columns, deviation, centre = rng.standard_normal((10, 2)), np.array([0.7, 2.0]), np.array([0.4, -1.0])
    errors = rng.standard_normal(10) + columns @ np.array([1.0, -0.5])
    covariance = columns @ np.diag(deviation**2) @ columns.T + np.eye(10)
    expected = multivariate_normal(columns @ centre, covariance).logpdf(errors)
    stacked = np.concatenate([errors[:, None], columns], axis=1)
    found = posterior_of(stacked.T @ stacked, 0.0, deviation, centre)
    assert found.evidence - 5 * np.log(2 * np.pi) == pytest.approx(expected)
    gain = np.diag(deviation**2) @ columns.T @ np.linalg.inv(covariance)
    assert found.mean == pytest.approx(centre + gain @ (errors - columns @ centre))
    assert found.covariance == pytest.approx(np.diag(deviation**2) - gain @ columns @ np.diag(deviation**2))


def test_whitened_errors_have_the_likelihood_of_the_whole_process() -> None:
    """State of two, one force, position measured four times: the filter agrees with the joint Gaussian.

    What derivatives miss adds two independent errors in each step; steps are of different lengths.
    """
    rng = np.random.default_rng(5)
    steps, level = 4, 0.6
    stay = np.exp(-np.array([0.01, 0.03, 0.005, 0.02]) / CORRELATION_S)
    transition = rng.standard_normal((1, steps, 2, 2)) * 0.3 + np.eye(2)
    force = rng.standard_normal((1, steps, 2, 1))
    noise, start = rng.uniform(0.1, 0.4, (1, steps, 1)), np.array([[0.5, 0.3]])
    root = rng.standard_normal((steps, 2, 2)) * 0.2
    missed = (root @ root.transpose(0, 2, 1))[None]
    own = Filter.of(transition, force, missed, noise, start, np.array([0]), level, stay[None])
    known, measured = rng.standard_normal((1, steps, 2, 1)) * 0.1, rng.standard_normal((1, steps, 1, 1))
    whitened = own.whiten(known, measured)
    found = -0.5 * ((whitened**2).sum() + own.log_determinant.sum() + steps * np.log(2 * np.pi))
    # Every state is a sum of independent unit numbers: two of the start, one force and its renewals, two of each step.
    forces = np.zeros((steps, 2 + steps))
    forces[0, 2] = level
    for k in range(1, steps):
        forces[k] = stay[k - 1] * forces[k - 1]
        forces[k, 2 + k] += level * np.sqrt(1 - stay[k - 1] ** 2)
    state, mean = np.zeros((2, 2 + 3 * steps)), np.zeros(2)
    forces = np.pad(forces, ((0, 0), (0, 2 * steps)))
    state[:, :2] = np.diag(start[0])
    rows, means = [], []
    for k in range(steps):
        state = transition[0, k] @ state + force[0, k] @ forces[k : k + 1]
        state[:, 2 + steps + 2 * k : 4 + steps + 2 * k] += root[k]
        mean = transition[0, k] @ mean + known[0, k, :, 0]
        rows.append(state[0])
        means.append(mean[0])
    spread = np.array(rows) @ np.array(rows).T + np.diag(noise[0, :, 0] ** 2)
    expected = multivariate_normal(np.array(means), spread).logpdf(measured[0, :, 0, 0])
    assert found == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("differs", "ratio"), [(0.0, 1.0), (3.0, 10.0)])
def test_a_number_that_differs_between_segments_scatters(differs: float, ratio: float) -> None:
    """Each of 400 segments tells a number to a deviation of one, and truly has its own, ``differs`` apart."""
    rng, segments, rows = np.random.default_rng(0), 400, 25
    own = 2 + differs * rng.standard_normal(segments)
    column = np.ones((segments, rows)) / np.sqrt(rows)
    other = rng.standard_normal((segments, rows))
    errors = own[:, None] * column + 0.5 * other + rng.standard_normal((segments, rows))
    whitened = [np.stack([errors, column, other], axis=2)[:, :, None]]
    blocks = Blocks([(k, 0, rows) for k in range(segments)], np.zeros(segments, int), np.zeros((1, segments)))
    evidence = Evidence.of(blocks, whitened, np.zeros((1, segments, 0, 0)))
    scatter = evidence.scatter(np.full(2, 100.0), np.zeros(2), np.array([0]))
    assert scatter == pytest.approx(ratio, rel=0.2)


@pytest.mark.parametrize(
    ("gained", "missing", "closure", "share"),
    [
        (300.0, 100.0, None, 0.25),  # on feet: of the evidence alone
        (300.0, 100.0, 0.9, 0.1),  # of the gap of whole logs, where that is less
        (300.0, 100.0, 0.2, 0.25),
        (300.0, 100.0, 1.2, 0.0),
        (-50.0, 100.0, None, 1.0),
        (300.0, -20.0, 0.2, 0.0),
    ],
)
def test_what_a_set_leaves_is_a_share_of_the_evidence_or_of_the_gap(
    gained: float, missing: float, closure: float | None, share: float
) -> None:
    start, found = SimpleNamespace(predictive=7.0), SimpleNamespace(predictive=7.0 + gained, missing=missing)
    assert left_unnamed(cast(Found, start), cast(Found, found), closure) == pytest.approx(share)


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> tuple[Robot, Intervals]:
    """The guide's arm with two logs that plain MuJoCo has made, cut into intervals."""
    folder = tmp_path_factory.mktemp("arm")
    robot = Robot.load(plain_arm.write_model(folder))
    logs = read_logs(plain_arm.write_parquet(folder / "logs", 2))
    judged = JudgedLogs.of(logs, robot, {})
    return robot, Intervals.of(judged.states, Replayer(robot, 1, 1), 0.01)


def test_derivatives_tell_what_they_miss(arm: tuple[Robot, Intervals]) -> None:
    """Of y = x + x²/2 of normal numbers: slope 1, and the variance σ⁴/2 of the square."""
    robot, nv = arm[0], arm[0].model.nv
    rng = np.random.default_rng(3)
    root = np.tril(0.1 * rng.standard_normal((3 * nv, 3 * nv)))[None]
    at_rest = Motion(np.zeros((1, robot.model.nq)), np.zeros((1, nv)))
    own = Displacements(root, np.ones(nv))
    starts, forces = own.starts(at_rest, robot)
    assert np.cov(np.concatenate([starts, forces], axis=1).T, bias=True) * (1 + 6 * nv) / 6 == pytest.approx(
        root[0] @ root[0].T, abs=1e-12
    )
    bent = starts[:, :1] + 0.5 * starts[:, :1] ** 2
    reached = Motion.of_states(np.concatenate([bent, starts[:, 1:]], axis=1), robot.model.nq)
    by_state, by_force, missed = own.derivatives(reached, robot)
    assert by_state[0] == pytest.approx(np.eye(2 * nv), abs=1e-9)
    assert by_force == pytest.approx(0.0, abs=1e-9)
    expected = np.zeros((2 * nv, 2 * nv))
    expected[0, 0] = 0.5 * (root[0, 0] @ root[0, 0]) ** 2
    assert missed[0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(("height_m", "feet", "barely"), [(0.005, 0, False), (-0.0002, 0, True), (-0.004, 4, False)])
def test_feet_touch_or_barely_do(height_m: float, feet: int, barely: bool) -> None:
    """An A1 on level feet, whose soles are so far above the ground."""
    model = Robot.load(DEFAULT_MODEL).model
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    spheres = [k for k in range(model.ngeom) if model.geom_type[k] == mujoco.mjtGeom.mjGEOM_SPHERE]
    lowest = min(data.geom_xpos[k, 2] - model.geom_size[k, 0] for k in spheres)
    data.qpos[2] += height_m - lowest
    pressing, near = touching(model, data, data.qpos.copy())
    assert (len(pressing), near) == (feet, barely)
    assert (model.geom_margin == Robot.load(DEFAULT_MODEL).model.geom_margin).all()


def test_columns_of_a_joint_are_those_of_its_torque(arm: tuple[Robot, Intervals]) -> None:
    """Damping and friction of one joint, shared out of a replay with both, beside plain MuJoCo with that one alone."""
    robot, intervals = arm
    chunks = Chunks.of(intervals)
    none = [np.zeros((own.intervals, 4)) for own in intervals.courses]
    intervals, linearisation = linearise(intervals, chunks, none)
    hypotheses = list_hypotheses([effects.known()["joint_damping"]], robot, None)
    columns = Columns.of(intervals, linearisation, hypotheses)
    (index,) = [i for i, key in enumerate(columns.keys) if key.place == "elbow"]
    own = intervals.courses[0]
    model, harder = (mujoco.MjModel.from_xml_string(plain_arm.arm()) for _ in range(2))
    harder.dof_damping[1] += 0.1
    chosen = range(5, own.intervals, 20)
    plain = np.array([(end_of(own, k, harder) - end_of(own, k, model)) / 0.1 for k in chosen])[:, 2:]
    found = columns.values[0][list(chosen)][:, 2:, index]
    assert np.corrcoef(plain.ravel(), found.ravel())[0, 1] > 0.99
    assert np.linalg.norm(found) == pytest.approx(np.linalg.norm(plain), rel=0.1)


def end_of(own: Course, k: int, model: mujoco.MjModel, kd: float = plain_arm.KD) -> np.ndarray:
    """State at the end of an interval by plain MuJoCo; a joint PD of its own damping is a force, computed each step."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = np.split(own.start_states[k], 2)
    wanted, speed = (own.states.log.per_joint(name, plain_arm.JOINTS) for name in ("cmd_pos", "cmd_vel"))
    for row in range(own.rows[own.begins[k]], own.rows[own.begins[k] + 1]):
        for _ in range(round(plain_arm.PERIOD_S / model.opt.timestep)):
            data.qfrc_applied[:] = plain_arm.KP * (wanted[row] - data.qpos) + plain_arm.KD * speed[row] - kd * data.qvel
            mujoco.mj_step(model, data)
    return np.concatenate([data.qpos, data.qvel])


def test_a_joint_pd_may_be_computed_once_a_step_or_implicitly(arm: tuple[Robot, Intervals]) -> None:
    """What the other way changes, beside plain MuJoCo with the damper as a force, and in the implicit joint."""
    robot, intervals = arm
    other = otherwise_integrated(robot, np.full(2, plain_arm.KD), intervals.replayer.largest_step_s)
    assert other is not None
    none = [np.zeros((own.intervals, 4)) for own in intervals.courses]
    intervals, linearisation = linearise(intervals, Chunks.of(intervals), none)
    (found,) = intervals.changes([[(other,) for _ in intervals.courses]], linearisation.transitions)
    implicit = mujoco.MjModel.from_xml_string(plain_arm.arm())
    explicit = mujoco.MjModel.from_xml_string(plain_arm.arm())
    implicit.dof_damping[:] += plain_arm.KD
    own, chosen = intervals.courses[0], range(5, intervals.courses[0].intervals, 20)
    plain = np.array([end_of(own, k, implicit, 0.0) - end_of(own, k, explicit) for k in chosen])
    assert found[0][list(chosen)] == pytest.approx(plain, abs=1e-3 * np.abs(plain).max())
    # A step that would take more than its speed from a joint is no way to compute it.
    assert otherwise_integrated(robot, np.zeros(2), 0.001) is None
    stiff = Robot.load(intervals.robot.path)
    stiff.model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert otherwise_integrated(stiff, np.full(2, 100.0), 0.001) is None
    assert otherwise_integrated(stiff, np.full(2, 1.5), 0.001) is not None


def found_by_evidence(folder: Path, robot: Robot) -> Diagnosis:
    """The diagnosis of logs by the engine."""
    return diagnose(read_logs(folder), robot, Settings(best=False), threads=1)


@pytest.mark.long
def test_damping_of_an_elbow_is_named_with_its_number(tmp_path: Path) -> None:
    """Logs of plain MuJoCo, whose joint PD is a force outside the model."""
    robot = Robot.load(plain_arm.write_model(tmp_path))
    report = found_by_evidence(plain_arm.write_parquet(tmp_path / "logs", 2), robot).report
    assert report.verdict == "named"
    assert report.answer[0] == ("joint_damping",)
    assert report.causes[0].location == "elbow"
    damping = report.causes[0].parameters["damping"]
    assert damping.value == pytest.approx(plain_arm.TRUE - plain_arm.BELIEVED, rel=0.05)
    assert report.evidence_numbers is not None
    assert report.evidence_numbers.u < 0.05 * report.evidence_numbers.u_before


@pytest.mark.long
def test_a_torque_limit_far_from_the_models_is_named(tmp_path: Path) -> None:
    """No column at nominal shows it: within its own limits the model is never at one."""
    logs, robot = pd_arms.logs(pd_arms.Truth(limit=8.0, size=0.8)), pd_arms.robot(tmp_path)
    report = diagnose(logs, robot, Settings(best=False), threads=1).report
    assert (report.verdict, report.answer) == ("named", (("torque_limit",),))
    assert report.causes[0].parameters["scale"].value == pytest.approx(8.0 / 200.0, rel=0.05)


@pytest.mark.long
def test_a_force_that_no_effect_has_is_unknown(tmp_path: Path) -> None:
    """A spring in the elbow's cable that tugs with a torque by the angle, six times a turn: no cause is named."""
    robot = Robot.load(plain_arm.write_model(tmp_path))
    logs = tmp_path / "logs"
    logs.mkdir()
    tugging = plain_arm.EXAMPLE.MODEL.format(elbow=plain_arm.EXAMPLE.BELIEVED)
    write_tugged(logs, tugging, 0.5)
    report = found_by_evidence(logs, robot).report
    assert report.verdict in ("unknown", "partly")
    assert report.evidence_numbers is not None
    assert report.evidence_numbers.u > 20 * report.evidence_numbers.blocks


@pytest.mark.long
def test_a_cause_beside_a_force_that_no_effect_has_is_told_where_it_explains_most(tmp_path: Path) -> None:
    """The same spring, weaker, at an elbow with more damping than the model."""
    robot = Robot.load(plain_arm.write_model(tmp_path))
    logs = tmp_path / "logs"
    logs.mkdir()
    write_tugged(logs, plain_arm.EXAMPLE.MODEL.format(elbow=plain_arm.EXAMPLE.TRUE), 0.15)
    report = found_by_evidence(logs, robot).report
    assert (report.verdict, report.answer) == ("partly", (("joint_damping",),))
    assert report.causes[0].location == "elbow"
    assert report.causes[0].parameters["damping"].value == pytest.approx(plain_arm.TRUE - plain_arm.BELIEVED, rel=0.1)


def test_a_number_beyond_its_range_costs_what_holding_it_loses(arm: tuple[Robot, Intervals]) -> None:
    """Two standard deviations beyond the end, two nats: half the square."""
    (gain,) = (h for h in list_hypotheses([effects.known()["torque_gain"]], arm[0], None) if h.location == "all")
    (end,), spread = gain.bounds[1], np.array([[0.01]])
    assert lost_in_range([gain], np.array([end - 0.1]), spread) == 0
    assert lost_in_range([gain], np.array([end + 0.2]), spread) == pytest.approx(2.0)


def write_tugged(folder: Path, xml: str, size: float) -> None:
    """Two logs of an arm whose elbow feels a torque of ``size`` N·m times sin 6q beside its joint PD."""
    model = mujoco.MjModel.from_xml_string(xml)
    for seed in range(2):
        columns = plain_arm.swing(seed)
        rng, data = np.random.default_rng(100 + seed), mujoco.MjData(model)
        wanted, speed = (
            np.stack([columns[f"{name}/{joint}"] for joint in plain_arm.JOINTS], axis=1)
            for name in ("cmd_pos", "cmd_vel")
        )
        data.qpos[:], data.qvel[:] = wanted[0], speed[0]
        for row in range(len(wanted)):
            for i, joint in enumerate(plain_arm.JOINTS):
                columns[f"joint_pos/{joint}"][row] = data.qpos[i] + 2e-4 * rng.standard_normal()
                columns[f"joint_vel/{joint}"][row] = data.qvel[i] + 5e-3 * rng.standard_normal()
            for _ in range(round(plain_arm.PERIOD_S / model.opt.timestep)):
                data.qfrc_applied[:] = plain_arm.KP * (wanted[row] - data.qpos) + plain_arm.KD * (
                    speed[row] - data.qvel
                )
                data.qfrc_applied[1] += size * np.sin(6 * data.qpos[1])
                mujoco.mj_step(model, data)
        table = pa.table(columns).replace_schema_metadata({"leapgap": json.dumps(plain_arm.EXAMPLE.INFO)})
        pq.write_table(table, folder / f"tug_{seed}.parquet")
