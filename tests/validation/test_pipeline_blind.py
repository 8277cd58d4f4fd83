"""No path leads from a truth to a verdict: by the graph, by the imports, and by running a case elsewhere."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf

from leapgap import effects
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.reports.diagnosis import diagnose_folder
from leapgap.reports.kept import KEPT, keep, kept, write_kept_pages
from leapgap.reports.verdict_jobs import Job, run_jobs
from leapgap.robot.model import Robot
from leapgap.runtime.cache import ResultCache
from leapgap.runtime.executor import Executor
from leapgap.validation.case import CaseSetup, withhold, write_case
from leapgap.validation.case_draw import Case
from stages.compose import compose_conf
from stages.sections.diagnosis import diagnosis_settings
from tests.code import ROOT, closure
from tests.commands import stage
from tests.test_pipeline_files import stages

pytestmark = pytest.mark.long

FAST: dict[str, Any] = {
    "best": False,  # as in every withheld diagnosis: answers are judged
    "effects": ["joint_damping"],
    "pieces_per_log": 4,
    "noise_draws": 1,
    "bootstrap_draws": 20,
    "folds": 2,
}


def paths(entries: list) -> set[str]:
    return {path.split(" ")[0].replace("${item}", "*") for e in entries for path in ([e] if isinstance(e, str) else e)}


def upstream_of(name: str) -> set[str]:
    """All stages whose outputs a stage depends on, at any remove."""
    table = stages()
    outs = {stage: paths(spec.get("outs", [])) | paths(spec.get("metrics", [])) for stage, spec in table.items()}
    seen: set[str] = set()
    open_ = {name}
    while open_:
        deps = paths(table[open_.pop()].get("deps", []))
        new = {stage for stage, own in outs.items() if own & deps} - seen
        seen |= new
        open_ |= new
    return seen


def test_no_truth_is_upstream_of_a_verdict() -> None:
    table = stages()
    assert "data/withheld/truth" in paths(table["withhold"]["outs"])
    readers = {name for name, stage in table.items() if "data/withheld/truth" in paths(stage.get("deps", []))}
    assert readers == {"revisit", "score"}
    assert not upstream_of("diagnose_withheld") & readers
    assert {"withhold", "diagnose_withheld", "revisit"} <= upstream_of("score")
    assert "truth" not in table["diagnose_withheld"]["cmd"]
    assert not [key for key in table["diagnose_withheld"]["params"] if key.split(".")[0] == "withhold"]


def test_dvc_sees_the_same_graph() -> None:
    said = subprocess.run(
        [str(Path(sys.executable).with_name("dvc")), "dag", "--dot", "diagnose_withheld"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    assert "withhold" in said
    assert "revisit" not in said
    assert "score" not in said


def test_the_diagnosis_imports_nothing_of_the_generator() -> None:
    for module in ("leapgap.diagnosis.diagnose", "stages.diagnose"):
        assert not [name for name in closure(module) if name.startswith("leapgap.validation")]
    hidden = {
        "leapgap.validation.off_table",
        "leapgap.validation.generator",
        "leapgap.validation.case_draw",
        "leapgap.validation.case",
    }
    assert not hidden & closure("stages.diagnose_withheld")


def test_a_verdict_is_kept_by_the_code_it_is_made_with_and_no_more() -> None:
    """Its page is part of it; recordings, pages of other results and the code that knows a sweep's jobs are not."""
    hashed = closure(diagnose_folder.__module__)
    views = {name for name in hashed if name.startswith("leapgap.reports.")}
    figures = (
        "channels_data",
        "diagnosis_figures",
        "written",
    )
    assert views == {f"leapgap.reports.{name}" for name in ("diagnosis", "page", "report", "viewer", *figures)}
    assert hashed >= closure("leapgap.diagnosis.diagnose")
    used = {name for name in closure("stages.diagnose") if name.startswith("leapgap.")}
    assert used - hashed <= closure("leapgap.reports.kept") | {"leapgap.runtime.import_closure"}


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory, references: list[Log], robot: Robot, world: CaseSetup) -> Path:
    folder = tmp_path_factory.mktemp("withheld")
    acting = (effects.effect("joint_damping", damping=0.8),)
    made = withhold(Case("reported", "single", acting, seed=5), references, robot, world)
    write_case(made, folder / "logs" / "case_000", folder / "truth" / "case_000")
    return folder


def job_of(case: Path) -> Job:
    settings = diagnosis_settings(OmegaConf.create(compose_conf()), FAST)
    return Job("case_000", case / "logs/case_000", ROOT / "src/leapgap/robot/a1.xml", settings)


def run(jobs: list[Job], out: Path) -> None:
    run_jobs(jobs, ResultCache(out), Executor("local", 1))


@pytest.fixture(scope="module")
def verdicts(case: Path) -> Path:
    """The verdict of the case, diagnosed once."""
    run([job_of(case)], case / "verdicts")
    return case / "verdicts"


def test_a_page_written_later_is_the_same_bytes(case: Path, verdicts: Path) -> None:
    run([replace(job_of(case), pages=False)], case / "kept")
    assert not (case / "kept/case_000/report.html").exists()
    again = case / "kept_again"
    again.mkdir()
    keep(kept(case / "kept/case_000"), again)
    assert (again / KEPT).read_bytes() == (case / "kept/case_000" / KEPT).read_bytes()
    (case / "pages").mkdir()
    write_kept_pages(["case_000"], case / "kept", case / "pages")
    for name in ("report.html", "report.json", "corrected/robot.xml"):
        assert (case / "pages/case_000" / name).read_bytes() == (verdicts / "case_000" / name).read_bytes()


def test_a_verdict_is_the_same_bytes_in_an_empty_folder_and_in_place(case: Path, verdicts: Path) -> None:
    settings = [f"diagnose.settings.{key}={json.dumps(value)}" for key, value in FAST.items()]
    out = case / "in_place"
    arguments = (f"diagnose.logs={case}/logs/case_000", f"diagnose.out={out}", "diagnose.recordings=false", *settings)
    done = stage("diagnose", *arguments)
    assert done.returncode == 0, done.stderr
    for name in ("report.json", "corrected/effects.json", "corrected/robot.xml"):
        assert (verdicts / "case_000" / name).read_bytes() == (out / name).read_bytes()
    assert str(case) not in (out / "report.json").read_text()


def test_what_is_diagnosed_is_not_diagnosed_again(
    case: Path, verdicts: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = (verdicts / "case_000.key").stat().st_mtime_ns
    capsys.readouterr()
    run([job_of(case)], verdicts)
    assert "1 of them diagnosed already" in capsys.readouterr().out
    assert (verdicts / "case_000.key").stat().st_mtime_ns == first
    log = case / "logs/case_000/jump_0.parquet"
    shutil.copyfile(case / "logs/case_000/jump_1.parquet", case / "swap")
    kept = log.read_bytes()
    log.write_bytes((case / "swap").read_bytes())
    assert job_of(case).key != json.loads((verdicts / "case_000.key").read_text())["key"]
    log.write_bytes(kept)


def test_a_diagnosis_that_fails_is_told_and_leaves_no_verdict(case: Path) -> None:
    broken = job_of(case)
    (case / "empty" / "case_001").mkdir(parents=True, exist_ok=True)
    (case / "empty/case_001/jump.parquet").write_text("no log")
    bad = Job("case_001", case / "empty/case_001", broken.robot, broken.settings)
    with pytest.raises(InputError, match="case_001: found InputError"):
        run([bad, broken], case / "broken")
    assert not (case / "broken/case_001").exists()
    assert (case / "broken/case_000/report.json").exists()


def double(x: int) -> int:
    return 2 * x


@pytest.mark.parametrize("kind", ["local", "joblib"])
def test_executors_give_the_same_results_in_order(kind: str) -> None:
    assert list(Executor(kind, 2).map(double, [3, 1, 2])) == [6, 2, 4]


def test_an_executor_that_is_not_there_is_told() -> None:
    with pytest.raises(InputError, match="local, joblib or ray"):
        Executor("slurm", 1)
    try:
        import ray  # noqa: F401
    except ImportError:
        with pytest.raises(InputError, match="not installed"):
            list(Executor("ray", 1).map(double, [1]))
