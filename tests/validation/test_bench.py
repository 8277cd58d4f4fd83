"""The bench: a case that takes too long or fails, the figures of a family, and that no reported half is drawn."""

import multiprocessing
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from leapgap.diagnosis.settings import Settings
from leapgap.reports.verdict_jobs import Job
from leapgap.validation.outcome import outcome, truth_in_words
from stages import bench_cases as bench
from stages.bench_table import NO_ANSWER, markdown, row_of, row_without_answer, summary
from stages.common import CONF
from stages.compose import compose_conf
from tests.validation.test_scoring import report, truth

TIMES = {"cpu_s": 2.0, "wall_s": 3.0}


def job(tmp_path: Path) -> Job:
    return Job("verdicts/a1/case_000", tmp_path, tmp_path / "robot.xml", Settings(), 1)


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="needs fork")
def test_a_case_that_takes_too_long_ends_and_is_tried_again_with_more_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def endless(*_: object, **__: object) -> None:
        while True:
            pass

    monkeypatch.setattr(bench, "diagnose_folder", endless)
    monkeypatch.setattr(bench, "Robot", type("Robot", (), {"load": staticmethod(lambda path: path)}))
    times = bench.diagnosed(job(tmp_path), tmp_path, 1)
    assert times["error"] == "no answer in 1 s of processor time"
    assert bench.is_to_be_tried_again(times, 2)
    assert not bench.is_to_be_tried_again(times, 1)


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="needs fork")
def test_a_case_that_fails_says_why_and_is_not_tried_again(tmp_path: Path) -> None:
    times = bench.diagnosed(job(tmp_path), tmp_path, 5)  # there is no robot
    assert "robot.xml" in times["error"]
    assert not bench.is_to_be_tried_again(times, 100)


def test_figures_of_a_family_by_hand() -> None:
    made = [
        (truth("single", "joint_damping"), report("named", [["joint_damping"]]), 0.75),
        (truth("single", "torque_gain"), report("named", [["payload"]]), 0.2),
        (truth("nameless", "wind"), report("partly", [["payload"]]), 0.1),
        (truth("nameless", "tether"), report("unknown", []), None),
        (truth("none", change=0.0), report("none", []), None),
    ]
    rows = [row_of(outcome(f"case_{i}", t, r, c), r) | TIMES for i, (t, r, c) in enumerate(made)]
    slow = truth("single", "torque_gain")
    rows.append(row_without_answer(slow, truth_in_words(slow), "no answer in 9 s") | TIMES)
    found = summary(rows)
    assert found["right"] == [4, 6]  # `partly` is right by the rule of the benchmark, and states a false name
    assert found["honest"] == [3, 6]
    assert found["first"] == [1, 2]
    assert found["wrongly_named"] == [1, 6]
    assert found["no_word_left_open"] == [2, 2]
    assert found["no_word_without_false_name"] == [1, 2]
    assert found["no_answer"] == [1, 6]
    assert found["promise_error"] == pytest.approx((0.05 + 0.6 + 0.7) / 3)
    text = markdown(
        {"a1": {"figures": found, "missing": ["case_9"], "cases": {f"case_{i}": row for i, row in enumerate(rows)}}}
    )
    assert "| case_1 |" in text
    assert NO_ANSWER in text
    assert "missing: case_9" in text


def test_evidence_of_a_report_is_shown_where_it_has_numbers() -> None:
    own = report("unknown", [], evidence={"g": 3.0, "u": 200.0, "d": 1.0})
    row = row_of(outcome("case", truth("nameless", "wind"), own, None), own)
    assert (row["g"], row["u"], row["d"]) == (3.0, 200.0, 1.0)


def test_no_reported_half_is_drawn() -> None:
    chosen = OmegaConf.load(CONF / "bench" / "default.yaml")
    for family, asked in chosen.draws.items():
        overrides = [one for one in (*bench.DRAWN, *bench.NOTHING, *asked) if not one.startswith("executor")]
        section = OmegaConf.create(compose_conf(overrides)).withhold
        halves = [section.halves, section.further, section.owners, *(own.halves for own in section.robots.values())]
        assert all(set(own) == {"tuning"} for own in halves), family
        assert section.published is None
