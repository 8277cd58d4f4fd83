"""What a user reads: help of every stage, the version, the nearest key to a misspelt one; from any folder."""

import shlex
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from leapgap import Settings, __version__, cli
from leapgap.errors import InputError
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.runtime.executor import Executor
from leapgap.settings import from_json
from leapgap.validation.half_scores import check_judged_logs
from stages.compose import compose_conf
from stages.help import describe
from tests.code import ROOT
from tests.commands import assert_refused, python, stage

NAMES = sorted(path.stem for path in (ROOT / "stages").glob("*.py") if '__name__ == "__main__"' in path.read_text())


@pytest.mark.parametrize("name", NAMES)
def test_help_says_what_a_stage_does_with_examples_and_its_options(name: str, tmp_path: Path) -> None:
    result = stage(name, "--help", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    settings = (ROOT / "conf" / name / "default.yaml").is_file()
    assert f"usage: python -m stages.{name} [{'key=value' if settings else 'word'} …]" in result.stdout
    assert ("robot.model=" in result.stdout) == settings
    assert f"Examples:\n\n    python -m stages.{name}" in result.stdout
    conf = ROOT / "conf" / name / "default.yaml"
    if conf.is_file():
        assert "Units: m, rad, s, N" in result.stdout
        for key in OmegaConf.load(conf):
            if key != "defaults":
                assert f"  {name}.{key}" in result.stdout
    assert not list(tmp_path.iterdir()), "asking for help wrote something"


def test_examples_name_options_that_exist() -> None:
    keys = OmegaConf.create(compose_conf())
    for name in NAMES:
        _, docstring, code = (ROOT / "stages" / f"{name}.py").read_text().split('"""', 2)
        words = [word for line in docstring.splitlines() if "python -m" in line for word in shlex.split(line)]
        for word in words:
            if word.startswith("--"):
                assert f'"{word.split("=")[0]}' in code, f"{name}: {word}"
            elif "=" in word and not word.startswith("size="):
                section, _, key = word.split("=")[0].rpartition(".")
                assert key in OmegaConf.select(keys, section), f"{name}: {word}"


def test_options_take_default_and_comment_from_the_configuration() -> None:
    text = "# Section x.\nlogs: data  # folder\npart:\n  step_s: 0.1  # of the grid\n# above it\nlong: 3\n"
    assert [" ".join(line.split()) for line in describe(text, "x")] == [
        "x.logs=data folder",
        "x.part.…",
        "x.part.step_s=0.1 of the grid",
        "x.long=3 above it",
    ]


def test_the_version_of_a_stage(tmp_path: Path) -> None:
    result = stage("chunk", "--version", cwd=tmp_path)
    assert (result.returncode, result.stdout) == (0, f"leapgap {__version__}\n")


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "question"),
    [
        (("collect", "collect.jmps=3"), "did you mean collect.jumps?"),
        (("chunk", "chunk.flight_steps=0.05"), "did you mean chunk.flight_step_s?"),
        (("chunk", "siez=tiny"), "did you mean size?"),
        (("diagnose", "diagnose.settings.most_pices=3"), "did you mean diagnose.settings.most_pieces?"),
        (("chunk", "+chunk.stepps=3"), "did you mean steps?"),
        (("chunk", "size=tny"), "found no size=tny; expected one of blind, default, full, tiny; did you mean tiny?"),
        (("chunk", "chunk.ot=x"), "found the unknown key chunk.ot; expected a key of conf/; did you mean chunk.out?"),
        (
            ("chunk", "--hlp"),
            "found --hlp; expected key=value, --help, --version or an option of Hydra; did you mean --he",
        ),
        (("chunk", "steps"), "found steps, which sets nothing; expected key=value; write it so, or see --help"),
        (("chunk", "chunk.steps=two"), "chunk.steps: found 'two'; expected a value of type int"),
    ],
)
def test_a_misspelt_key_is_answered_with_the_nearest(tmp_path: Path, arguments: tuple[str, ...], question: str) -> None:
    name, *given = arguments
    refused = stage(name, *given, f"{name}.out={tmp_path / 'out'}")
    assert_refused(refused, question)
    for advice in (
        "use +",
        "hydra.cc",
        "search path",
        "did you mean steps?" if "chunk.steps=two" in given else "use +",
    ):
        assert advice not in refused.stderr, "advice that is of no use"


@pytest.mark.parametrize(
    ("arguments", "question"),
    [
        (("diagnos", "a", "b"), "did you mean diagnose?"),
        (("diagnose", "a", "b", "--effcts", "x"), "did you mean --effects?"),
    ],
)
def test_a_misspelt_command_is_answered_with_the_nearest(
    arguments: tuple[str, ...], question: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main(list(arguments))
    assert end.value.code == 2
    assert question in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [("leapgap.cli", "effects"), ("stages.chunk", "--help")])
def test_a_terminal_that_lacks_a_character_gets_its_code(arguments: tuple[str, ...]) -> None:
    """Windows and old locales know no ``→`` or ``²``."""
    done = python("-m", *arguments, PYTHONIOENCODING="ascii")
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert r"N\xb7m" in done.stdout


def test_a_misspelt_setting_of_a_file_is_answered_with_the_nearest(tmp_path: Path) -> None:
    (tmp_path / "settings.json").write_text('{"bootstrap_drws": 3}')
    with pytest.raises(InputError, match=r"did you mean bootstrap_draws\?"):
        from_json(Settings, tmp_path / "settings.json")


def test_a_stage_finds_the_projects_robot_from_any_folder(tmp_path: Path) -> None:
    (tmp_path / "raw").mkdir()
    result = stage("import_logs", "import_logs.source=raw", "import_logs.out=jumps", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "jumps" / ".leapgap.json").is_file()


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("collect", "collect.jumps=0"), "jumps 0: 1 or more"),
        (("collect", "executor.workers=0"), "workers 0: 1 or more"),
        (("collect", "collect.mpc.period_s=nan"), "period_s"),
        (("diagnose", "diagnose.threads=-1"), "threads -1: null or a number of 1 or more"),
        (("collect", "robot.body.mass_kg=0.0"), "mass_kg 0.0"),
        (("train", "train.folds=0"), "folds 0: 1 or more"),
        (("train", "train.threads=-1"), "threads -1: 1 or more"),
        (("train", "robot.body.mass_kg=0.0"), "mass_kg 0.0"),
    ],
)
def test_numbers_that_mean_nothing_are_refused(tmp_path: Path, arguments: tuple[str, ...], says: str) -> None:
    name, *given = arguments
    assert_refused(stage(name, *given, f"{name}.out={tmp_path / 'out'}"), says)
    assert not (tmp_path / "out").exists()


def test_bodies_and_executors_refuse_what_means_nothing() -> None:
    for mass in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match="mass_kg"):
            RigidBody(mass, 0.3)
    assert RigidBody(12.0, float("inf")).pitch_inertia_kgm2 == float("inf")
    assert Executor("joblib", -1).workers == -1
    with pytest.raises(ValueError, match="workers -3"):
        Executor("joblib", -3)


OTHERS: list[dict] = [{}, {"provenance": 3}, {"provenance": {}}, {"provenance": {"logs": {"a": "2f"}}}]


@pytest.mark.parametrize("report", OTHERS)
def test_a_report_on_other_logs_than_the_sealed_ones_is_not_scored(report: dict) -> None:
    check_judged_logs("case_1", {"logs": {"a.parquet": "1f"}}, {"provenance": {"logs": {"a": "1f"}}})
    with pytest.raises(InputError, match=r"^report of case_1: found logs other than those sealed"):
        check_judged_logs("case_1", {"logs": {"a.parquet": "1f"}}, report)
