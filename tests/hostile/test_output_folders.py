"""No command removes a file that it did not write, whatever folder it is given as its output."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from leapgap import cli
from leapgap.errors import InputError
from leapgap.logs import log as jump_log
from leapgap.robot.model import Robot
from leapgap.runtime.output_folder import claim_folder, merged_folder, whole_folder
from tests import plain_arm
from tests.commands import assert_refused, stage
from tests.conftest import standing
from tests.logs.test_importers import write_published

TEST = "leapgap test"


def content(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def write(folder: Path, **files: str) -> None:
    with whole_folder(folder, TEST) as empty:
        for name, text in files.items():
            (empty / name).parent.mkdir(parents=True, exist_ok=True)
            (empty / name).write_text(text)


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """A folder with files of the user, some of which have names that the stages use."""
    folder = tmp_path / "mine"
    names = ("thesis.txt", "note.json", "report.html", "landing.json", "splits.json", "plotly.js", "all/notes.key")
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(f"my {name}")
    record = {"key": "0" * 64, "value": 1}  # as results of version 0.1 looked
    (folder / "precious.json").write_text(json.dumps(record))
    return folder


@pytest.fixture
def logs(tmp_path: Path, robot: Robot) -> Path:
    for i in range(2):
        jump_log.write_log(standing(robot, 1300), tmp_path / "logs" / f"jump_{i}.parquet")
    return tmp_path / "logs"


STAGES = {
    "optimize": ("optimize.out", "optimize.targets=[[0.4,0.0]]"),
    "collect": ("collect.out", "collect.jumps=1"),
    "import_logs": ("import_logs.out", "import_logs.source={empty}"),
    "chunk": ("chunk.out", "chunk.logs={logs}"),
    "train": ("train.out", "train.windows={windows}"),
    "evaluate": ("evaluate.out", "evaluate.windows={windows}"),
    "diagnose": ("diagnose.out", "diagnose.logs={empty}"),
    "withhold": ("withhold.logs", "withhold.truth={other}"),
    "diagnose_withheld": ("diagnose_withheld.out", "diagnose_withheld.logs={empty}"),
    "revisit": ("revisit.out", "revisit.verdicts={empty}"),
    "score": ("score.out", "score.logs={empty}"),
    "land": ("land.out", "size=tiny"),
    "land_page": ("land_page.out", "land_page.landings={empty}"),
    "report": ("report.out", "report.diagnosis={empty}"),
    "practise": ("practise.out", "size=tiny"),
    "bench": ("bench.out", "bench.cases={empty}"),
    "view": ("view.out", "view.references={empty}"),
    "export": ("export.out", "export.landings={empty}"),
    "robots": ("robots.out", "robots.raw={empty}"),
}
"""For each stage that writes a folder: its key, and an argument with which it would begin to work."""


@pytest.mark.long
@pytest.mark.parametrize("name", STAGES)
def test_every_stage_refuses_a_folder_of_the_users(name: str, mine: Path, logs: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    before = content(mine)
    key, argument = STAGES[name]
    places = {place: tmp_path / place for place in ("empty", "logs", "windows", "other")}
    result = stage(name, f"{key}={mine}", argument.format(**places))
    assert_refused(result, str(mine), "which leapgap did not write there", "choose another output folder")
    assert content(mine) == before
    assert not list(tmp_path.glob(".*")), "a lock or a temporary folder was left"


def test_every_stage_that_writes_a_folder_is_tried_above() -> None:
    from tests.code import ROOT

    writing = {path.stem for path in (ROOT / "stages").glob("*.py") if "output_folder(" in path.read_text()}
    assert writing - {"common"} == set(STAGES)


def test_raw_logs_survive_an_import_into_the_folder_above_them(tmp_path: Path, robot: Robot) -> None:
    write_published(tmp_path / "home" / "raw" / "3", robot)
    before = content(tmp_path)
    source, home = f"import_logs.source={tmp_path / 'home/raw'}", tmp_path / "home"
    for out in (home, home / "raw", home / "raw" / "jumps"):
        assert_refused(stage("import_logs", source, f"import_logs.out={out}"), str(out), "the input")
    assert content(tmp_path) == before


def test_an_own_output_is_replaced_and_only_what_is_listed_goes(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(out, **{"a.txt": "1", "sub/b.txt": "1"})
    write(out, **{"a.txt": "2"})
    assert sorted(content(out)) == [".leapgap.json", "a.txt"]
    assert (out / "a.txt").read_text() == "2"
    assert not (out / "sub").exists()


@pytest.mark.parametrize("foreign", ["thesis.txt", "sub/thesis.txt", ".hidden"])
def test_a_foreign_file_in_an_own_output_is_named_and_kept(tmp_path: Path, foreign: str) -> None:
    out = tmp_path / "out"
    write(out, **{"a.txt": "1"})
    (out / foreign).parent.mkdir(exist_ok=True)
    (out / foreign).write_text("mine")
    with pytest.raises(InputError, match=f"{foreign} in it, which leapgap did not write there"):
        write(out, **{"a.txt": "2"})
    assert (out / foreign).read_text() == "mine"
    assert (out / "a.txt").read_text() == "1"


def test_a_file_that_comes_while_the_work_goes_on_is_kept(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(out, **{"a.txt": "1"})
    with pytest.raises(InputError, match=r"late\.txt"), whole_folder(out, TEST) as empty:
        (empty / "a.txt").write_text("2")
        (out / "late.txt").write_text("mine")
    assert sorted(content(out)) == [".leapgap.json", "a.txt", "late.txt"]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_the_output_of_another_command_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "out", **{"a.txt": "1"})
    with pytest.raises(InputError, match=r"a folder that leapgap test wrote"), whole_folder(tmp_path / "out", "other"):
        pass
    with pytest.raises(InputError, match=r"a folder that leapgap test wrote"):
        claim_folder(tmp_path / "out", "other")


def link(path: Path) -> None:
    (path.parent / "elsewhere").mkdir()
    path.symlink_to(path.parent / "elsewhere")


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda path: path.write_text("x"), "something that is no folder"),
        (link, "a link to"),
        (lambda path: path.symlink_to(path.parent / "nowhere"), "a link to"),
        (os.mkfifo, "no folder"),
    ],
)
def test_what_is_no_folder_is_refused(tmp_path: Path, make: Callable[[Path], object], says: str) -> None:
    out = tmp_path / "out"
    make(out)
    with pytest.raises(InputError, match=says):
        write(out, **{"a.txt": "1"})
    assert out.is_symlink() or not out.is_dir()


@pytest.mark.long
@pytest.mark.parametrize("place", ["/proc", "/proc/self", "/proc/self/out", "/", "/dev/null", "/dev/null/out"])
def test_folders_of_the_system_are_refused(place: str) -> None:
    for name, key, argument in (("chunk", "chunk.out", ""), ("train", "train.out", "train.folds=2")):
        assert_refused(stage(name, f"{key}={place}", *filter(None, [argument])), place)


def test_a_marker_that_leads_out_of_its_folder_is_none(tmp_path: Path) -> None:
    """A hostile marker lists a file of the user's beside the folder; nothing outside is removed."""
    write(tmp_path / "out", **{"a.txt": "1"})
    (tmp_path / "thesis.txt").write_text("mine")
    path = tmp_path / "out" / ".leapgap.json"
    path.write_text(path.read_text().replace('"a.txt"', '"../thesis.txt"'))
    with pytest.raises(InputError, match="which leapgap did not write there"):
        write(tmp_path / "out", **{"a.txt": "2"})
    assert (tmp_path / "thesis.txt").read_text() == "mine"


def test_links_in_an_own_output_are_removed_and_not_what_they_lead_to(tmp_path: Path) -> None:
    """DVC may put links into its cache in the place of files."""
    write(tmp_path / "out", **{"a.txt": "1"})
    (tmp_path / "cached").write_text("1")
    (tmp_path / "out" / "a.txt").unlink()
    (tmp_path / "out" / "a.txt").symlink_to(tmp_path / "cached")
    write(tmp_path / "out", **{"a.txt": "2"})
    assert (tmp_path / "out" / "a.txt").read_text() == "2"
    assert (tmp_path / "cached").read_text() == "1"


def test_the_marker_says_who_wrote_what_and_nothing_that_changes(tmp_path: Path) -> None:
    import leapgap

    for name in ("one", "two"):
        write(tmp_path / name, **{"b.txt": "1", "a/c.txt": "2"})
    texts = {(tmp_path / name / ".leapgap.json").read_text() for name in ("one", "two")}
    assert len(texts) == 1
    expected = {"leapgap_output": 1, "by": TEST, "version": leapgap.__version__, "files": ["a/c.txt", "b.txt"]}
    assert json.loads(texts.pop()) == expected


def test_a_run_that_fails_leaves_the_output_as_it_was(tmp_path: Path) -> None:
    write(tmp_path / "out", **{"a.txt": "1"})
    before = content(tmp_path)
    with pytest.raises(RuntimeError), whole_folder(tmp_path / "out", TEST) as empty:
        (empty / "a.txt").write_text("2")
        raise RuntimeError
    assert content(tmp_path) == before


def test_files_are_added_beside_others_and_never_over_them(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    for text in ("1", "2"):
        with merged_folder(tmp_path, TEST) as beside:
            (beside / "a.txt").write_text(text)
    assert (tmp_path / "a.txt").read_text() == "2"
    with pytest.raises(InputError, match=r"mine\.txt in it"), merged_folder(tmp_path, TEST) as beside:
        (beside / "a.txt").write_text("3")
        (beside / "mine.txt").write_text("3")
    assert (tmp_path / "mine.txt").read_text() == "mine"
    assert (tmp_path / "a.txt").read_text() == "2"


def test_under_dvc_a_kept_output_without_a_marker_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Outputs that DVC keeps and an older version wrote; what the cache does not know stays in them."""
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "old.npz").write_text("1")
    with pytest.raises(InputError, match="if an older leapgap wrote this one, remove it yourself"):
        claim_folder(tmp_path / "models", "stages.train")
    monkeypatch.setenv("DVC_STAGE", "train")
    claim_folder(tmp_path / "models", "stages.train")
    assert sorted(content(tmp_path / "models")) == [".leapgap.json", "old.npz"]


def run(*arguments: object) -> int:
    return cli.main([str(one) for one in arguments])


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("arm")
    plain_arm.write_model(folder)
    plain_arm.write_parquet(folder / "logs")
    plain_arm.write_csv(folder / "tables")
    return folder


def test_the_command_refuses_folders_of_the_users(arm: Path, mine: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = content(mine)
    model = arm / "arm.xml"
    for arguments in (
        ("diagnose", arm / "logs", model),
        ("replay", arm / "logs", model),
        ("import", arm / "tables", model, "--format", "csv"),
    ):
        assert run(*arguments, "--out", mine) == 2
        said = capsys.readouterr().err
        assert "which leapgap did not write there" in said and len(said.splitlines()) == 1
    assert content(mine) == before


def test_the_command_does_not_write_replays_over_the_logs(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = content(arm)
    assert run("replay", arm / "logs", arm / "arm.xml", "--out", arm / "logs") == 2
    assert "the input" in capsys.readouterr().err
    assert content(arm) == before


def test_a_folder_within_that_is_replaced_keeps_nothing_of_an_earlier_run_and_all_that_is_foreign(
    tmp_path: Path,
) -> None:
    for names in (("whole/old/deep.txt", "whole/same.txt", "beside.txt"), ("whole/same.txt",)):
        with merged_folder(tmp_path, TEST, replaced=("whole", "absent")) as beside:
            for name in names:
                (beside / name).parent.mkdir(parents=True, exist_ok=True)
                (beside / name).write_text("ours")
        (tmp_path / "whole" / "mine.txt").write_text("foreign")
    left = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")}
    assert left - {".leapgap.json"} == {"whole", "whole/same.txt", "whole/mine.txt", "beside.txt"}
