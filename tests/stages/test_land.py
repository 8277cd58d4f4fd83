"""The stage of landings as a whole, small: every output, the resume, and the same bytes whatever runs it."""

import csv
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from leapgap.errors import InputError
from leapgap.jumping.experiments.rig import LandSettings, TrialRunner
from leapgap.logs import log as jump_log
from leapgap.robot.terrain import Box
from leapgap.runtime.atomic_io import read_json
from leapgap.runtime.cache import ResultCache
from stages.common import read_config
from stages.compose import compose_conf
from stages.sections.land import experiment_of
from tests.commands import assert_refused, stage

SMALL = (
    "size=tiny",
    "land.methods=[joint_pd,nominal_variable]",
    "land.tasks.block_60.repeats=0",
    "land.tasks.continuous_60={x_m: 0.5, jumps: 2, repeats: 1}",
)


def files(out: Path) -> dict[str, bytes]:
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()}


@pytest.fixture(scope="module")
def landing_results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("landed") / "out"
    result = stage("land", *SMALL, f"land.out={out}", "executor=joblib")
    assert result.returncode == 0, result.stderr
    assert result.stdout.count("worn/joint_pd/") == 2
    return out


def test_figures_table_page_and_logs_say_the_same(landing_results: Path) -> None:
    found = read_json(landing_results / "landing.json")
    assert set(found["error_cm"]) == {
        f"worn/{method}/{task}" for method in ("joint_pd", "nominal_variable") for task in ("jump_50", "continuous_60")
    }
    with (landing_results / "landings.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 6  # one, and two in a row, a method
    (row,) = [row for row in rows if row["task"] == "jump_50" and row["method"] == "joint_pd"]
    assert float(row["error_cm"]) == found["error_cm"]["worn/joint_pd/jump_50"]
    page = (landing_results / "report.html").read_text()
    assert "joint PD, 50 cm" in page
    assert f"{float(row['error_cm']):+.2f}" in page
    assert "https://" not in page.split("</script>", 1)[1]  # nothing is fetched from anywhere
    assert (landing_results / "runs/worn/joint_pd/jump_50_0.parquet").is_file()


def test_a_second_run_goes_on_from_what_is_kept_and_writes_the_same_bytes(landing_results: Path) -> None:
    before = files(landing_results)
    (landing_results / "runs/worn/nominal_variable/jump_50_0.json").unlink()
    old = landing_results / "runs/old_hardware/joint_pd"
    old.mkdir(parents=True)
    for ending in ("json", "key"):
        shutil.copyfile(landing_results / f"runs/worn/joint_pd/jump_50_0.{ending}", old / f"jump_50_0.{ending}")
    (landing_results / "runs/notes.txt").write_text("not written by the stage")
    result = stage("land", *SMALL, f"land.out={landing_results}", "executor=local")
    assert result.returncode == 0, result.stderr
    assert [line for line in result.stdout.splitlines() if line.startswith("worn/") and " over " not in line] == [
        line for line in result.stdout.splitlines() if line.startswith("worn/nominal_variable/jump_50_0")
    ]
    assert (landing_results / "runs/notes.txt").read_text() == "not written by the stage"
    (landing_results / "runs/notes.txt").unlink()
    assert files(landing_results) == before
    assert not (landing_results / "runs/old_hardware").exists()


def test_unknown_hardware_and_methods_are_refused(tmp_path: Path) -> None:
    assert_refused(
        stage("land", *SMALL, f"land.out={tmp_path / 'a'}", "land.hardware=[rusty]"), "land.hardware", "rusty"
    )
    assert_refused(stage("land", *SMALL, f"land.out={tmp_path / 'b'}", "land.methods=[magic]"), "land.methods", "magic")
    assert not (tmp_path / "a" / "landing.json").exists()


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("hardware", [], "land: found no hardware or no methods; "),
        ("methods", [], "land: found no hardware or no methods; "),
        ("single", ["jmp_40"], "land.single: found jmp_40; .* did you mean jump_40?"),
        ("tasks.jump_40.repeats", 10**9, "land.tasks.jump_40.repeats: found 1000000000; expected 0 "),
        ("tasks.jump_40.repeats", -1, "land.tasks.jump_40.repeats: found -1; "),
        ("tasks.jump_40.repeats", "often", "land.tasks.jump_40.repeats: found 'often'; "),
        ("practice.rounds", [-1], "land: found identify_jumps 4, random_jumps 16, rounds \\[-1\\]: "),
        ("practice.identify_jumps", 0, "land: found identify_jumps 0, "),
    ],
)
def test_experiments_without_a_meaning_are_refused_before_any_run(key: str, value: object, says: str) -> None:
    config = OmegaConf.create(compose_conf())
    config.land.hardware, config.land.only = ["worn"], {}
    OmegaConf.update(config.land, key, value)
    with pytest.raises(InputError, match=f"^{says}"):
        experiment_of(config, read_config(LandSettings, config.land, "land"))


@pytest.mark.parametrize("names", [["box_60_20", "jump_60"], ["box_60_20"]])
def test_robots_practise_without_a_box_whatever_the_first_task_is(
    names: list[str], reference: jump_log.Log, tmp_path: Path
) -> None:
    box = replace(reference.info, terrain=(Box(0.9, 0.0, (1.2, 1.0, 0.2), 0.2),))
    jump_log.write_log(reference, tmp_path / "h00_d60.parquet")
    jump_log.write_log(replace(reference, info=box), tmp_path / "h20_d60.parquet")
    config = OmegaConf.create(compose_conf())
    config.land.references, config.land.hardware = str(tmp_path), ["worn"]
    config.land.single = names
    config.land.tasks = {name: config.land.tasks[name] for name in names}
    experiment = experiment_of(config, read_config(LandSettings, config.land, "land"))
    rig = experiment.rig(experiment.hardware[0], TrialRunner(ResultCache(tmp_path / "runs"), map))
    assert rig.bench.references[experiment.tasks[0].target].info.terrain, "the first task lost its box"
    assert rig.bench.level.info.terrain == ()
