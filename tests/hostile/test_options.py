"""Files of options and settings that are damaged, made to harm, or say something that no import can do."""

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from leapgap import Settings, cli
from leapgap.errors import InputError
from leapgap.logs.importers.table_format import TableOptions
from leapgap.settings import from_json
from tests import plain_arm

LONGEST_S = 20
"""Time after which a command counts as one that hangs; each of these takes less than a second."""


@pytest.fixture(autouse=True)
def limit() -> Iterator[None]:
    def late(*_: object) -> None:
        raise TimeoutError(f"no answer in {LONGEST_S} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(LONGEST_S)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("arm")
    plain_arm.write_csv(made / "logs", 2)
    plain_arm.write_model(made)
    return made


QUANTITIES = ("joint_pos", "joint_vel", "cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")
MAP = "columns:\n" + "".join(f"  {name}/*: {name}_*\n" for name in QUANTITIES)
BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{k + 1}: &a{k + 1} [{', '.join([f'*a{k}'] * 9)}]\n" for k in range(8)
)
"""Four hundred million values in eight lines."""


def import_with(folder: Path, options: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit code and message of an import with these options."""
    arguments = ("import", folder / "logs", folder / "arm.xml", "--format", "csv", "--options", options)
    code = cli.main([*map(str, arguments), "--out", str(options.parent / "out")])
    return code, capsys.readouterr().err


def test_the_map_itself_is_taken(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "map.yaml").write_text(MAP)
    assert import_with(folder, tmp_path / "map.yaml", capsys) == (0, "")


MERGED = "a0: &a0 {k: 1}\n" + "".join(f"a{i}: &a{i}\n  <<: [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 31))
BROKEN = {
    "twice": ("yaml", "period_s: 0.001\nperiod_s: 0.001\n", "the key period_s twice"),
    "twice_below": ("yaml", "columns: {time: t, time: t}\n", "the key time twice"),
    "twice_json": ("json", '{"period_s": 0.001, "period_s": 0.001}', "the key period_s twice"),
    "deep": ("yaml", "columns: " + "[" * 3000 + "]" * 3000, "nested too deep"),
    "deep_maps": ("yaml", "columns: " + "{a: " * 3000 + "1" + "}" * 3000, "nested too deep"),
    "deep_json": ("json", "[" * 100_000 + "]" * 100_000, "nested too deep"),
    "huge_number": ("yaml", f"period_s: {'9' * 400}\n", "a value of type float"),
    "huge_number_json": ("json", json.dumps({"period_s": 10**400}), "a value of type float"),
    "bomb": ("yaml", f"{BOMB}joint_order: [*a8]\n", "values; expected at most"),
    "loop": ("yaml", "joint_order: &a [*a]\n", "nested too deep"),
    "merged": ("yaml", f"{MERGED}columns: *a30\n", "more than 100000 values"),
    "base_sixty": ("yaml", f"period_s: 1{':59' * 100_000}\n", "a number of 300001 characters"),
    "part_of_a_piece": ("yaml", "pieces: [{name: a, begin_s: 0}]\n", "pieces[0]: found no end_s"),
    "long": ("yaml", "# " + "x" * 20_000_000, "bytes; expected at most"),
}
"""Name → ending, text, and words of the message."""


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_of_options_is_one_message(
    name: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    end, text, says = BROKEN[name]
    path = tmp_path / f"options.{end}"
    path.write_text(text)
    code, said = import_with(folder, path, capsys)
    assert code == 2 and says in said and str(path) in said, said[:1000]
    assert len(said.splitlines()) == 1 and len(said) < 1500


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (os.mkfifo, "a named pipe"),
        (Path.mkdir, "a folder"),
        (lambda path: path.symlink_to("/dev/zero"), "a device"),
        (lambda path: path.symlink_to(path.name), "a path that cannot be opened"),
        (lambda _: None, "no such file"),
    ],
)
def test_options_that_are_no_file_are_not_waited_for(
    make: object, says: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make(path := tmp_path / "options.yaml")  # type: ignore[operator]
    code, said = import_with(folder, path, capsys)
    assert code == 2 and said.startswith(f"leapgap import: {path}: found {says}"), said


MEANINGLESS = {
    "piece_s": ("piece_s: 1.0e-9", "csv.piece_s: found 1e-09"),
    "resample_s": ("resample_s: 1.0e-8", "in rows of 1e-08 s: found"),
    "resample_inf": ("resample_s: .inf", "csv.resample_s: found inf"),
    "period_inf": ("period_s: .inf", "csv.period_s: found inf"),
    "window_inf": ("velocity_window_s: .inf", "csv.velocity_window_s: found inf"),
    "least_rows": ("least_rows: -5", "csv.least_rows: found -5"),
    "most_rows": ("most_rows: 0", "csv.most_rows: found 0"),
    "target": ("target_x_m: .inf", "csv.target_x_m: found inf"),
    "segment": ("segments: [{name: a, begin_s: 2, end_s: 1}]", "csv.segments"),
    "segment_nan": ("segments: [{name: a, begin_s: .inf, end_s: .inf}]", "csv.segments"),
    "piece_backwards": ("pieces: [{name: a, begin_s: 2, end_s: 1}]", "csv.pieces"),
    "schedule": (
        "schedule: {double_contact_s: -1, rear_contact_s: 0.1, flight_s: 0.1}",
        "csv.schedule: found double_contact_s -1",
    ),
    "factor": ("factors: {joint_pos/*: 0}", "csv.factors, joint_pos/shoulder: found 0"),
}
"""Name → options, and words of the message."""


@pytest.mark.parametrize("name", MEANINGLESS)
def test_options_that_mean_nothing_are_refused_by_name(
    name: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options, says = MEANINGLESS[name]
    (tmp_path / "options.yaml").write_text(f"{MAP}{options}\n")
    code, said = import_with(folder, tmp_path / "options.yaml", capsys)
    assert code == 2 and says in said, said[:1000]
    assert "Warning" not in said


@pytest.mark.parametrize("name", ["../../evil", "/tmp/evil", "a/b", "a\\b", "", ".", "nul\0", "lone\ud800", "x" * 300])
def test_names_of_pieces_become_names_of_files_and_must_be_such(
    name: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Else a map that somebody sends writes where he likes, or several logs over each other."""
    (tmp_path / "logs").mkdir()
    piece = json.dumps({"name": name, "begin_s": 0, "end_s": 1})
    (tmp_path / "options.yaml").write_text(f"{MAP}pieces: [{piece}]\n")
    code, said = import_with(folder, tmp_path / "options.yaml", capsys)
    assert code == 2 and "csv.pieces" in said and "a name of a file" in said, said
    assert not (tmp_path / "out").exists()


def test_two_pieces_of_one_name_are_refused(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pieces = "[{name: a, begin_s: 0, end_s: 1}, {name: a, begin_s: 1, end_s: 2}]"
    (tmp_path / "options.yaml").write_text(f"{MAP}pieces: {pieces}\n")
    code, said = import_with(folder, tmp_path / "options.yaml", capsys)
    assert code == 2 and "csv.pieces: found the name a twice" in said, said


def test_settings_of_a_diagnosis_are_read_the_same_way(tmp_path: Path) -> None:
    path = tmp_path / "settings.json"
    path.write_text('{"folds": 2, "folds": 3}')
    with pytest.raises(InputError, match="the key folds twice"):
        from_json(Settings, path)
    path.write_text(json.dumps({"horizon_s": 10**400}))
    with pytest.raises(InputError, match=r"settings\.json, horizon_s: found a whole number of 401 digits"):
        from_json(Settings, path)


def test_anchors_of_yaml_may_be_used(tmp_path: Path) -> None:
    path = tmp_path / "options.yaml"
    path.write_text("columns: &map {time: t}\nunits: {<<: *map, joint_pos/*: deg}\n")
    assert from_json(TableOptions, path) == TableOptions(
        columns={"time": "t"}, units={"time": "t", "joint_pos/*": "deg"}
    )
