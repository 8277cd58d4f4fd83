"""What a hostile user gives the command beside logs and robots: reports, corrected robots, effects, settings, names."""

import json
import os
import shutil
import subprocess
import sys
import time
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from leapgap import Settings, cli, registry
from leapgap.effects.model_field import ModelField
from leapgap.errors import InputError
from leapgap.logs import importers
from leapgap.logs.importers.base import LogFormat
from leapgap.logs.reading import read_folder
from leapgap.reports.diagnosis import ChosenLogs
from leapgap.runtime.atomic_io import write_json, write_text
from tests import plain_arm
from tests.commands import environment, python


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


def test_a_foreign_text_sends_nothing_to_the_terminal(
    arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Such as a sequence that sets the title of its window, or clears what was printed before."""
    (tmp_path / "report.html").write_text("page")
    (tmp_path / "report.json").write_text(json.dumps({"sentence": "a \x1b]0;title\x07 and \x1b[2J and \x9b3J"}))
    assert cli.main(["report", str(tmp_path), "--no-browser"]) == 0
    assert capsys.readouterr().out.startswith("a \\x1b]0;title\\x07 and \\x1b[2J and \\x9b3J\n")
    (tmp_path / "logs").mkdir()
    for name in ("a", "c"):
        (tmp_path / "logs" / f"{name}\x1b[2J.parquet").write_bytes(b"no log")
    assert cli.main(["diagnose", str(tmp_path / "logs"), str(arm / "arm.xml")]) == 2
    said = capsys.readouterr().err
    assert "\x1b" not in said and "a\\x1b[2J" in said


DAMPING = {"name": "joint_damping", "location": "all"}
CORRECTED = {
    "number": ({"effects": [3]}, "found 3; expected an effect"),
    "text_value": ({"effects": [DAMPING | {"damping": "much"}]}, "effect joint_damping, damping: found 'much'"),
    "infinite": ({"effects": [DAMPING | {"damping": float("inf")}]}, "effect joint_damping, damping: found inf"),
    "huge": ({"effects": [DAMPING | {"damping": 1e300}]}, "effect joint_damping, damping: found 1e+300"),
    "true": ({"effects": [DAMPING | {"damping": True}]}, "effect joint_damping, damping: found True"),
    "list_place": ({"effects": [DAMPING | {"location": ["elbow"], "damping": 0.1}]}, "location: found ['elbow']"),
    "motors": ({"effects": [], "motors": {"volt": 1}}, "motors: found the keys volt"),
    "motors_list": ({"effects": [], "motors": [1]}, "motors: found [1]"),
    "names": ({"effects": [], "names": {"toes": 1}}, "names: found the keys toes"),
    "names_number": ({"effects": [], "names": {"feet": 5}}, "names, feet: found 5"),
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
    with pytest.raises(InputError, match=rf"^settings\.{name}: found .*; expected .*{expected}"):
        Settings(**{name: value})


def test_a_range_of_a_model_field_without_ends_is_refused() -> None:
    for ends in ((float("-inf"), 1.0), (0.0, float("inf"))):
        with pytest.raises(InputError, match=r"found .*inf.*; expected lower below upper, both finite"):
            ModelField("dof_damping", *ends, element="elbow")


ONE_EFFECT = ("--effects", "joint_damping", "--threads", "1", "--quiet")


def logs_of(folder: Path, *columns: dict) -> Path:
    """Logs of ours with these columns, by pyarrow alone."""
    folder.mkdir()
    for number, one in enumerate(columns):
        table = pa.table({name: pa.array(values) for name, values in one.items()})
        about = {"leapgap": json.dumps(plain_arm.EXAMPLE.INFO)}
        pq.write_table(table.replace_schema_metadata(about), folder / f"log_{number}.parquet")
    return folder


def test_copies_of_a_log_are_set_aside(tmp_path: Path, arm: Path) -> None:
    """A cause is judged on logs that it was not fitted on; a copy would be judged by itself."""
    first, second = plain_arm.swing(0, 1.0), plain_arm.swing(1, 1.0)
    readings = read_folder(logs_of(tmp_path / "logs", first, second, first, second))
    chosen = ChosenLogs.of(readings)
    assert [log.name for log in chosen.logs] == ["log_0", "log_1"]
    assert list(chosen.set_aside) == ["log_2", "log_3"]
    assert "equal to log_1 in every column" in chosen.set_aside["log_3"]


def test_one_log_and_its_copies_are_refused(arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = logs_of(tmp_path / "logs", *[plain_arm.swing(0, 1.0)] * 3)
    assert "found 1 log; expected two or more" in refused(capsys, "diagnose", logs, arm / "arm.xml", *ONE_EFFECT)


def test_logs_in_which_nothing_moves_are_refused(arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without noise there is nothing that a gap could be judged by; the quotient of the two had no value."""
    motion = plain_arm.swing(0, 1.0)
    still = [
        {
            name: values if name == "time" else np.full_like(values, 0.0 if "vel/" in name else values[row])
            for name, values in motion.items()
        }
        for row in (0, 300)
    ]
    said = refused(capsys, "diagnose", logs_of(tmp_path / "logs", *still), arm / "arm.xml", *ONE_EFFECT)
    assert "found logs in which nothing moves" in said


@pytest.mark.parametrize(
    ("code", "says"),
    [
        ("1 / 0", "code that fails while it is imported (ZeroDivisionError: division by zero)"),
        ("raise SyntaxError('bad')", "code that fails while it is imported (SyntaxError: bad)"),
        ("class Theirs(Base): pass", "found no find, read; expected all of LogFormat"),
        ("class Theirs(Base):\n    find = read = None", "found no name; expected a text as name of the class"),
    ],
)
def test_a_plug_in_that_fails_is_named(code: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = f"plug_in_{abs(hash(code))}"
    (tmp_path / f"{module}.py").write_text(f"from leapgap.logs.importers.base import LogFormat as Base\n{code}\n")
    monkeypatch.syspath_prepend(tmp_path)
    point = EntryPoint("theirs", f"{module}:Theirs", "leapgap.log_formats")
    monkeypatch.setattr(registry, "entry_points", lambda group: [point])
    with pytest.raises(InputError) as refusal:
        registry.classes_by_name(importers, LogFormat, "leapgap.log_formats")
    assert str(refusal.value).startswith(f"{module}:Theirs: ") and says in str(refusal.value)


def test_a_map_is_proposed_for_what_can_be_read_alone(
    arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder := tmp_path / "pipe").mkdir()
    os.mkfifo(folder / "a.csv")
    assert "found a named pipe" in refused(capsys, "import", folder, arm / "arm.xml", "--guess")
    (folder := tmp_path / "noise").mkdir()
    (folder / "a.npz").write_bytes(b"PK" + bytes(range(256)) * 9)
    assert "a.npz" in refused(capsys, "import", folder, arm / "arm.xml", "--guess")


def test_a_table_of_ten_thousand_columns_is_answered_soon(
    arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The names of columns were compared pair by pair."""
    names = ["time", *(f"joint_pos_{number}" for number in range(20_000))]
    rows = "".join(f"{row / 100},{'0,' * 19_999}0\n" for row in range(12))
    (tmp_path / "a.csv").write_text(",".join(names) + f"\n{rows}")
    began = time.process_time()
    said = refused(capsys, "import", tmp_path / "a.csv", arm / "arm.xml", "--guess")
    assert "found 20001 columns; expected at most 10000" in said
    assert time.process_time() - began < 10


def test_names_of_files_that_are_no_text_reach_the_report(tmp_path: Path) -> None:
    write_json(tmp_path / "report.json", {"set_aside": {"bad\udcff": "so"}})
    assert json.loads((tmp_path / "report.json").read_text(encoding="utf-8")) == {"set_aside": {"bad\udcff": "so"}}
    write_text(tmp_path / "page.html", "bad\udcff")
    assert (tmp_path / "page.html").read_bytes() == rb"bad\udcff"


@pytest.mark.parametrize(("shell", "code"), [(">&-", 0), (">&- 2>&-", 0), (">/dev/full", 2)])
def test_a_closed_or_full_output_is_no_traceback(shell: str, code: int) -> None:
    called = ["sh", "-c", f'exec "$@" {shell}', "sh", sys.executable, "-m", "leapgap.cli", "effects"]
    done = subprocess.run(called, env=environment(), capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == code, done.stderr
    assert len(done.stderr.splitlines()) == (code == 2), done.stderr


def test_a_disk_that_is_full_while_a_report_is_written(arm: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ("diagnose", arm / "logs", arm / "arm.xml", "--out", out, *ONE_EFFECT)
    done = python("-m", "leapgap.cli", *arguments, most_bytes=50_000)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1 and "File too large" in done.stderr, done.stderr
    assert f"{out} is as it was" in done.stderr and not list(tmp_path.iterdir())
