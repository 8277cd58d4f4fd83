"""What a hostile user gives the command beside logs and robots: reports, corrected robots, effects, settings, names."""

import json
import shutil
from pathlib import Path

import pytest

from leapgap import Settings, cli
from leapgap.diagnosis.selection import SearchSettings
from leapgap.effects.model_field import ModelField
from leapgap.errors import InputError
from tests import plain_arm


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("arm")
    plain_arm.write_parquet(folder / "logs", 2)
    plain_arm.write_model(folder)
    return folder


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The message with which the command ends."""
    assert cli.main([str(one) for one in arguments]) == 2
    captured = capsys.readouterr()
    assert len(captured.err.splitlines()) == 1, captured.err
    return captured.err


REPORTS = {
    "empty": (b"", "no valid JSON"),
    "list": (b"[1]", "found list; expected a JSON object"),
    "no_sentence": (b"{}", "no sentence; expected a report"),
    "number": (b'{"sentence": 5}', "no sentence; expected a report"),
    "deep": (b"[" * 100_000, "no valid JSON"),
    "no_text": (b"\xff\xfe", "no valid JSON"),
}


@pytest.mark.parametrize("name", REPORTS)
def test_a_broken_report_is_one_message(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, says = REPORTS[name]
    (tmp_path / "report.html").write_text("page")
    (tmp_path / "report.json").write_bytes(content)
    said = refused(capsys, "report", tmp_path, "--no-browser")
    assert said.startswith(f"leapgap report: {tmp_path / 'report.json'}: ") and says in said


DAMPING = {"name": "joint_damping", "location": "all"}
CORRECTED = {
    "number": ({"effects": [3]}, "found 3; expected an effect"),
    "text_value": ({"effects": [DAMPING | {"damping": "much"}]}, "effect joint_damping, damping: found 'much'"),
    "infinite": ({"effects": [DAMPING | {"damping": float("inf")}]}, "effect joint_damping, damping: found inf"),
    "huge": ({"effects": [DAMPING | {"damping": 1e300}]}, "effect joint_damping, damping: found 1e+300"),
    "true": ({"effects": [DAMPING | {"damping": True}]}, "effect joint_damping, damping: found True"),
    "list_place": ({"effects": [DAMPING | {"location": ["elbow"], "damping": 0.1}]}, "location: found ['elbow']"),
    "motors": ({"effects": [], "motors": {"volt": 1}}, "motors: found {'volt': 1}"),
    "motors_list": ({"effects": [], "motors": [1]}, "motors: found [1]"),
    "names": ({"effects": [], "names": {"toes": 1}}, "names: found toes 1"),
    "names_number": ({"effects": [], "names": {"feet": 5}}, "names: found feet 5"),
}


@pytest.mark.parametrize("name", CORRECTED)
def test_a_broken_corrected_robot_is_one_message(
    name: str, arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content, says = CORRECTED[name]
    (folder := tmp_path / "corrected").mkdir()
    shutil.copy(arm / "arm.xml", folder / "nominal.xml")
    (folder / "effects.json").write_text(json.dumps(content))
    assert says in refused(capsys, "replay", arm / "logs", folder, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("effect", "says"),
    [
        ("joint_damping:damping=inf", "effect joint_damping, damping: found inf"),
        ("joint_damping:damping=1e308", "effect joint_damping, damping: found 1e+308"),
        ("joint_damping:damping=0.1,damping=0.3", "--effect: found damping twice"),
    ],
)
def test_effects_that_no_robot_has_are_refused(
    effect: str, says: str, arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refused(capsys, "replay", arm / "logs", arm / "arm.xml", "--out", tmp_path / "out", "--effect", effect)
    assert says in said


@pytest.mark.parametrize("feet", [",", "upper,", "knee"])
def test_feet_without_a_name_are_refused(feet: str, arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = refused(capsys, "diagnose", arm / "logs", arm / "arm.xml", "--feet", feet)
    assert "feet among the named geoms and sites" in said


@pytest.mark.parametrize("threads", ["1025", "9" * 30, "0", "-1", "two"])
def test_threads_beyond_any_machine_are_refused(threads: str, arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main(["diagnose", str(arm / "logs"), str(arm / "arm.xml"), "--threads", threads])
    assert end.value.code == 2
    assert f"found {threads}; expected 1 to 1024" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("noise_draws", 10**9, "1 to 10000"),
        ("bootstrap_draws", 10**12, "1 to 1000000"),
        ("every_s", 1e-300, "at least a millionth of horizon_s"),
        ("horizon_s", 1e300, "1000 s at most"),
    ],
)
def test_settings_that_would_never_end_are_refused(name: str, value: float, expected: str) -> None:
    with pytest.raises(InputError, match=rf"^diagnose\.settings.{name}: found .*; expected .*{expected}"):
        Settings(**{name: value})


@pytest.mark.parametrize("name", ["shortlist", "per_effect", "steps", "promising", "beams", "most_causes"])
def test_a_search_without_steps_or_causes_is_refused(name: str) -> None:
    for value in (0, -1):
        with pytest.raises(InputError, match=rf"^diagnose\.settings.plan.{name}: found {value}; expected 1 or more"):
            SearchSettings(**{name: value})


def test_a_range_of_a_model_field_without_ends_is_refused() -> None:
    for ends in ((float("-inf"), 1.0), (0.0, float("inf"))):
        with pytest.raises(InputError, match=r"found .*inf.*; expected lower below upper, both finite"):
            ModelField("dof_damping", *ends, element="elbow")
