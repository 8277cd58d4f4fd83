"""The best simulator: all effects fitted together, on logs that plain MuJoCo simulated."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.best_simulator import DRAWN, BestFit, BestSimulator, by_columns, by_joint_fit, chosen_without
from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.diagnose import Diagnosis, diagnose
from leapgap.diagnosis.engine.points import Bench
from leapgap.diagnosis.engine.search import Found, Search
from leapgap.diagnosis.evidence.base import Evidence
from leapgap.diagnosis.gap import HeldOutGap
from leapgap.diagnosis.hypotheses import Hypothesis, list_hypotheses
from leapgap.diagnosis.joint_fit import JointFit
from leapgap.diagnosis.joint_likelihood import bounded_minimum
from leapgap.diagnosis.settings import Settings
from leapgap.logs.log import Log
from leapgap.reports.diagnosis import Report, diagnose_logs
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json
from leapgap.simulation.corrected import read_corrected, write_corrected
from tests.diagnosis.joint_fits import NOMINAL, heldout_gap, noisy_logs, short_rollouts
from tests.diagnosis.two_link_arm import torque_driven_arm
from tests.plain_simulation import Pd, by_motors, simulate

KINDS = ["joint_damping", "joint_friction", "armature", "torque_gain", "encoder_bias", "leg_mass"]
KINDS_HERE = {*KINDS, "link_mass"}  # as a robot without legs calls them
UNSEEN = Pd(18, 0.6, 0.6, 1.5)
"""A motion that no diagnosis sees."""


def worn(model: mujoco.MjModel) -> None:
    """What is hidden: damping at both joints, friction and armature more at the elbow, a heavier lower link."""
    model.dof_damping[:] += 0.2
    model.dof_frictionloss[:] = [0.1, 0.25]
    model.dof_armature[:] += [0.01, 0.03]
    model.body_mass[2] *= 1.15
    model.body_inertia[2] *= 1.15
    mujoco.mj_setConst(model, mujoco.MjData(model))


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return torque_driven_arm(tmp_path_factory.mktemp("arm"))


class OneCause(Search):
    """A search that ends with its first cause, so that much is left for a fit of all effects."""

    def explore(self) -> tuple[Found, Found]:
        start = self.judge(self.bench.nominal())
        return start, replace(self, most=1).ascend(start)


@pytest.fixture(scope="module")
def report(robot: Robot) -> Report:
    """The report on the worn arm of a diagnosis that looks for one cause only."""
    settings = Settings(effects=KINDS, noise_draws=1, bootstrap_draws=100)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("leapgap.diagnosis.diagnose.Search", OneCause)
        return diagnose_logs(noisy_logs(robot.path, worn), robot, settings, threads=2)


@pytest.fixture(scope="module")
def found(report: Report) -> Diagnosis:
    return report.diagnosis


def best_of(found: Diagnosis) -> BestSimulator:
    assert found.report.best_simulator is not None
    return found.report.best_simulator


def test_it_closes_more_of_held_out_logs_than_an_answer_of_fewer_causes(found: Diagnosis) -> None:
    best, report = best_of(found), found.report
    assert best.source == "joint fit"
    assert report.closure_of_answer is not None and len(report.answer) == 1
    assert best.closure.value > report.closure_of_answer.value + 0.1
    assert best.closure_of_answer == pytest.approx(report.closure_of_answer.value)
    assert best.closure.value > 0.95
    assert report.to_json()["best_simulator"]["closure"]["heldout"] == pytest.approx(best.closure.value, rel=1e-5)


def test_its_numbers_are_those_that_were_hidden_at_each_joint(found: Diagnosis) -> None:
    """To a twentieth, and 0.0015 kg·m²: a gain, masses and armatures that rise together leave a motion as it is."""
    values = {(one.effect, one.location): one.value for one in best_of(found).numbers}
    hidden = {
        ("joint_damping", "L_shoulder"): 0.2,
        ("joint_damping", "L_elbow"): 0.2,
        ("joint_friction", "L_shoulder"): 0.1,
        ("joint_friction", "L_elbow"): 0.25,
        ("armature", "L_shoulder"): 0.01,
        ("armature", "L_elbow"): 0.03,
        ("link_mass", "L_elbow"): 1.15,
    }
    for which, true in hidden.items():
        assert values[which] == pytest.approx(true, rel=0.05, abs=0.0015), which
    assert values["torque_gain", "L_elbow"] == pytest.approx(1, abs=0.05)


def test_numbers_that_make_up_for_each_other_are_not_to_be_believed(found: Diagnosis) -> None:
    """The torque gain of the elbow, which is nominal, is fitted together with its armature and mass."""
    numbers = {(one.effect, one.location): one for one in best_of(found).numbers}
    gain = numbers["torque_gain", "L_elbow"]
    assert not gain.believed
    assert any("do the same" in why or "does the same" in why for why in gain.why)
    named = {name for names in found.report.answer for name in names}
    assert {one.effect for one in best_of(found).believed} <= named


def test_its_model_reproduces_a_motion_that_it_never_saw_in_plain_mujoco(
    robot: Robot, found: Diagnosis, tmp_path: Path
) -> None:
    """``robot.xml`` of ``best/`` simulated by ``mj_step`` with the joint PD of the test, beside the worn arm."""
    write_corrected(tmp_path / "best", robot, best_of(found).effects)
    write_corrected(tmp_path / "corrected", robot, found.correction)

    def swing(path: Path, change=lambda _: None) -> np.ndarray:
        return simulate(path, by_motors, UNSEEN, rows=1500, change=change).qpos

    true = swing(robot.path, worn)
    nominal, corrected, best = (
        float(np.sqrt(np.mean((swing(path) - true) ** 2)))
        for path in (robot.path, tmp_path / "corrected" / "robot.xml", tmp_path / "best" / "robot.xml")
    )
    assert best < 0.02 * nominal
    assert best < 0.03 * corrected


def test_a_report_has_it_in_print_on_its_page_and_in_a_folder(report: Report, tmp_path: Path) -> None:
    best = best_of(report.diagnosis)
    report.save(tmp_path / "out")
    (line,) = [one for one in str(report).splitlines() if one.startswith("best simulator: ")]
    assert line.startswith("best simulator: all effects fitted together explain 100 % (95 %: ")
    assert line.endswith(f"; {len(best.believed)} of its {len(best.numbers)} numbers are reliable")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Use this model for prediction only." in page
    assert page.count('<td data-is="reliable" class="bad">no</td>') == len(best.numbers) - len(best.believed)
    stored = read_json(tmp_path / "out" / "report.json")["best_simulator"]
    assert [one["why"] for one in stored["numbers"]] == [list(one.why) for one in best.numbers]
    robot, effects = read_corrected(tmp_path / "out" / "best")
    assert effects == report.best == best.effects
    assert (tmp_path / "out" / "best" / "robot.xml").is_file()
    assert read_corrected(tmp_path / "out" / "corrected")[1] == report.correction != effects
    assert robot.joints == ("L_shoulder", "L_elbow")


def test_a_robot_with_nothing_wrong_keeps_its_nominal_numbers(robot: Robot) -> None:
    settings = Settings(effects=KINDS, noise_draws=1, bootstrap_draws=100)
    diagnosis = diagnose(noisy_logs(robot.path, lambda _: None), robot, settings, threads=2)
    best = best_of(diagnosis)
    assert diagnosis.report.verdict == "none"
    assert (best.source, best.effects, best.numbers) == ("answer", (), ())
    assert best.in_words.startswith("the nominal robot; no ")


def test_a_fit_of_all_effects_to_a_robot_with_nothing_wrong_has_nominal_in_its_intervals(robot: Robot) -> None:
    gap, search, start = nominal(noisy_logs(robot.path, lambda _: None), robot)
    fit = by_columns(search, start, KINDS_HERE)[len(DRAWN) - 1]
    numbers = BestFit(gap, NOMINAL, model_error=0.03).judged(fit.candidate, np.zeros(len(KINDS)))
    assert len(numbers) == len(KINDS)
    assert all(one.ci95[0] <= one.nominal <= one.ci95[1] for one in numbers)
    assert not any(one.believed for one in numbers)


def test_where_a_joint_fit_has_ended_no_other_is_made(robot: Robot) -> None:
    """A number that evidence tells is held, in every fold, and is not said to be left open by the logs."""
    gap = heldout_gap(noisy_logs(robot.path, worn), robot)
    told = Evidence("a test", "joint_damping.damping", 0.2, 0.01, "N·m·s/rad", {}, "said here")
    joint = JointFit(gap, short_rollouts(gap, robot), (told,))
    every = tuple(h for h in list_hypotheses(KINDS, robot, None) if h.location == "all")
    joint.fit(every, joint.numbers(every).centre, 3)
    assert [end.hypotheses for end in joint.ends] == [every]
    best = BestFit(gap, NOMINAL, 0.03).best(lambda: by_joint_fit(joint))
    assert best.source == "joint fit" and best.closure_of_answer == pytest.approx(0.0)
    assert best.closure.value > 0.5
    at = best.candidate.names.index("joint_damping")
    assert best.candidate.numbers[at] == 0.2 and (best.candidate.fold_numbers[:, at] == 0.2).all()
    assert not any("do not determine" in why for why in best.numbers[at].why)


def nominal(logs: list[Log], robot: Robot) -> tuple[HeldOutGap, Search, Found]:
    """The gap of some logs, a search in them, and the nominal robot."""
    gap = heldout_gap(logs, robot)
    bench = Bench(list_hypotheses(KINDS, robot, None), {}, gap.judged.states, gap.replayer)
    search = Search(bench, gap.folds, lambda _: None, gap=gap)
    return gap, search, search.judge(bench.nominal())


def test_the_numbers_of_a_fold_know_nothing_of_its_own_log(robot: Robot) -> None:
    """One log by a robot that is damped more changes those of the other folds alone."""
    logs, others = (
        noisy_logs(robot.path, lambda model, by=by: model.dof_damping.__iadd__(by))  # type: ignore[misc]
        for by in (0.2, 0.21)
    )
    found = []
    for some in (logs, [others[0], *logs[1:]]):
        _, search, start = nominal(some, robot)
        found.append(by_columns(search, start, {"joint_damping"})[0].candidate.fold_numbers[:, 0])
    own, *of_others = np.abs(found[1] - found[0])[np.argsort(np.arange(len(logs)) != search.folds[0])]
    assert own < 1e-5
    assert max(of_others) > 1e-4


def test_numbers_that_are_drawn_to_nominal_depart_less(robot: Robot) -> None:
    _, search, start = nominal(noisy_logs(robot.path, worn), robot)
    free, *_, drawn = (one.candidate for one in by_columns(search, start, KINDS_HERE)[: len(DRAWN)])
    scale = np.concatenate([np.abs(h.moderate) for h in free.hypotheses])
    assert np.linalg.norm(drawn.departs / scale) < np.linalg.norm(free.departs / scale)
    assert np.array_equal(drawn.covariance, free.covariance)


def test_a_candidate_that_is_best_by_one_log_alone_is_not_used_on_that_log() -> None:
    """The second candidate wins by the first log; judged by the other logs it loses, and there it is worse."""
    squares = np.array([[10.0, 4.0, 4.0], [1.0, 5.0, 5.0]])
    assert chosen_without(squares, np.ones(2), np.arange(3)).tolist() == [10.0, 5.0, 5.0]
    assert chosen_without(squares, np.array([1.0, 9.0]), np.arange(3)).tolist() == [10.0, 4.0, 4.0]


def test_a_minimum_within_limits_is_that_of_a_fine_grid() -> None:
    curvature, slope = np.array([[4.0, 3.0], [3.0, 3.0]]), np.array([-8.0, -5.0])
    lower, upper = np.array([-1.0, -0.5]), np.array([1.0, 2.0])
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 401), np.linspace(-0.5, 2, 501)), axis=-1).reshape(-1, 2)
    loss = 0.5 * np.einsum("ni,ij,nj->n", grid, curvature, grid) + grid @ slope
    assert bounded_minimum(curvature, slope, lower, upper) == pytest.approx(grid[loss.argmin()], abs=0.01)


def test_reasons_not_to_believe_a_number(robot: Robot) -> None:
    """Of a crafted fit: one that is sure, one that another stands in for, one at its end, one that is not told."""
    hypotheses = tuple(one(name, robot) for name in ("joint_friction", "armature", "joint_damping", "torque_gain"))
    end = hypotheses[2].bounds[1][0]
    numbers = np.array([0.5, 0.02, end, 0.99])
    spread = np.array([0.01, 0.001, 0.01, 0.05])
    alike = np.eye(4)
    alike[1, 3] = alike[3, 1] = 0.93
    candidate = Candidate(hypotheses, numbers, alike * np.outer(spread, spread), np.array([numbers] * 4))
    gap = heldout_gap(noisy_logs(robot.path, lambda _: None, rows=300), robot)
    fit = BestFit(gap, candidate, model_error=0.03)
    friction, armature, damping, gain = fit.judged(candidate, np.array([0.01, 0.05, 0.03, 0.8]))
    assert friction.believed and friction.why == ()
    assert armature.why == ("torque_gain scale does the same (correlation 0.93)",)
    assert damping.why == ("at the end of its range",)
    assert gain.why == (
        "the logs do not determine it, so that it stays where it was expected",
        "armature inertia does the same (correlation 0.93)",
        "its interval holds the nominal value",
    )
    others = replace(fit, answer=replace(candidate, hypotheses=hypotheses[1:]))
    assert others.judged(candidate, np.zeros(4))[0].why == ("it is not among the identified causes",)


def one(name: str, robot: Robot) -> Hypothesis:
    """An effect at all places."""
    return list_hypotheses([name], robot, None)[0]


def test_where_nothing_is_asked_for_nothing_is_fitted(robot: Robot) -> None:
    settings = Settings(effects=["joint_damping"], best=False, noise_draws=1, bootstrap_draws=20)
    diagnosis = diagnose(noisy_logs(robot.path, worn, rows=400), robot, settings, threads=2)
    assert diagnosis.report.best_simulator is None
    assert diagnosis.report.to_json()["best_simulator"] is None
