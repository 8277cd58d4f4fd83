"""Names that other people's files and folders have: quoted where they are printed or written, or refused."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from leapgap import cli, effects
from leapgap.diagnosis.departing_logs import without_departing
from leapgap.errors import CONTROL, InputError
from leapgap.jumping.published_a1 import PublishedA1
from leapgap.logs import reading
from leapgap.logs.log import Log, LogInfo, read_logs
from tests.hostile.base_logs import ARM, PERIOD_S, arm_log, write_csv, write_own

ESCAPE = "\x1b]0;owned\x07\x1b[2J"
INJECTED = "note\nevil: &a [1]\n# "


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    (tmp_path / "arm.xml").write_text(ARM)
    return tmp_path / "arm.xml"


def said(arguments: list[object], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit code of a command, and all that it printed: without any control character but new lines."""
    code = cli.main([str(one) for one in arguments])
    out, err = capsys.readouterr()
    assert CONTROL.search((out + err).replace("\n", "")) is None
    return code, out + err


@pytest.mark.parametrize("name", [ESCAPE, INJECTED, "a\u202eb", "a\x9bb"])
def test_names_of_columns_are_quoted_in_a_proposed_map(
    name: str, arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    columns = {(f'"{name}"' if key == "cmd_kp/hip" else key): values for key, values in arm_log(1).items()}
    text = ",".join(columns) + "\n"
    text += "\n".join(",".join(map(repr, row)) for row in np.stack(list(columns.values()), 1).tolist())
    (folder / "a.csv").write_text(text)
    code, printed = said(["import", folder, arm, "--guess"], capsys)
    assert code == 0 and set(yaml.safe_load(printed)) == {"format", "csv"}
    assert not [line for line in printed.split("\n") if line.startswith("evil")]


@pytest.mark.parametrize("name", [f"a{ESCAPE}".replace("/", ""), "a\nset aside b: well"])
def test_a_log_whose_name_is_no_line_of_text_is_set_aside(
    name: str, arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    for number, stem in enumerate(("one", name, "two")):
        write_csv(arm_log(number), folder / f"{stem}.csv")
    code, printed = said(["import", folder, arm, "--format", "csv", "--out", tmp_path / "out"], capsys)
    assert code == 0 and printed.count("\nset aside") + printed.startswith("set aside") == 1
    assert sorted(path.name for path in (tmp_path / "out").glob("*.parquet")) == ["one.parquet", "two.parquet"]


def test_metadata_with_control_characters_are_refused(tmp_path: Path) -> None:
    write_own(arm_log(1), tmp_path / "a.parquet", {"source": f"lab {ESCAPE}"})
    with pytest.raises(InputError, match=r"the text lab \\x1b"):
        read_logs(tmp_path)


def test_a_folder_that_may_not_be_read_is_named(
    arm: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As root every folder may be read, so the system is made to refuse."""
    folder, scandir = tmp_path / "logs", os.scandir
    (folder / "closed").mkdir(parents=True)
    write_own(arm_log(1), folder / "a.parquet")

    def refuse(path: object = ".") -> object:
        if str(path).endswith("closed"):
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "scandir", refuse)
    for arguments in (["check", folder], ["import", folder, arm, "--format", "published", "--out", tmp_path / "out"]):
        code, printed = said(arguments, capsys)
        assert code == 2 and "closed: found a folder that cannot be read (Permission denied)" in printed


@pytest.mark.parametrize("command", ["import", "replay", "diagnose"])
def test_an_output_that_is_no_utf8_is_refused_at_once(
    command: str, arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "logs").mkdir()
    write_own(arm_log(1), tmp_path / "logs" / "a.parquet")
    out = os.fsdecode(os.fsencode(tmp_path) + b"/out\xff")
    code, printed = said([command, tmp_path / "logs", arm, "--out", out], capsys)
    assert code == 2 and r"out\udcff: found a path that is not UTF-8" in printed
    assert not Path(out).exists()


def test_a_folder_named_by_a_digit_that_is_no_number_is_a_jump_of_that_name(tmp_path: Path) -> None:
    for name in ("²", "7", "٣"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "pos.txt").touch()
    assert set(PublishedA1().find(tmp_path)) == {"jump_²", "jump_07", "jump_03"}


@pytest.mark.parametrize("name", [["joint_damping"], {"a": 1}, 3, None])
def test_an_effect_whose_name_is_no_text_is_refused(name: object) -> None:
    with pytest.raises(InputError, match="expected one of "):
        effects.from_config([{"name": name, "location": "all"}])


def arm_logs(*numbers: int) -> list[Log]:
    """Some logs of the arm."""
    return [Log(f"log_{n}", arm_log(n), LogInfo("arm", PERIOD_S, "by hand")) for n in numbers]


@pytest.mark.parametrize(("noise", "says"), [(0.0, "in every column: a copy"), (1e-9, "in every column but for ")])
def test_copies_with_a_trace_of_noise_are_copies(noise: float, says: str) -> None:
    logs, rng = arm_logs(1, 2, 3), np.random.default_rng(1)
    columns = {name: values + noise * rng.standard_normal(len(values)) for name, values in logs[0].columns.items()}
    kept, aside = without_departing([*logs, replace(logs[0], name="copy", columns=columns | {"time": logs[0].time})])
    assert [log.name for log in kept] == ["log_1", "log_2", "log_3"]
    assert [one.name for one in aside] == ["copy"] and says in aside[0].reason


def test_logs_with_noise_of_sensors_are_no_copies() -> None:
    logs, rng = arm_logs(1, 2, 3), np.random.default_rng(1)
    columns = dict(logs[0].columns)
    columns["joint_pos/hip"] = columns["joint_pos/hip"] + 1e-5 * rng.standard_normal(len(logs[0]))
    kept, aside = without_departing([*logs, replace(logs[0], name="again", columns=columns)])
    assert len(kept) == 4 and not aside


def test_several_bad_logs_are_lines_of_one_message(tmp_path: Path) -> None:
    for name in ("a", "b\nc", "d"):
        (tmp_path / f"{name}.parquet").write_bytes(b"nothing")
    with pytest.raises(InputError) as refusal:
        reading.read_folder(tmp_path)
    assert len(str(refusal.value).split("\n")) == 5 and r"b\x0ac" in str(refusal.value)
