"""Each command that a report recommends is run as a reader would run it, from the folder where it says so."""

import html
import re
import shlex
import shutil
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

from leapgap import cli
from leapgap.reports.written import what_was_written
from tests.plain_arm import write_csv, write_model, write_parquet

SETTINGS = '{"noise_draws": 1, "bootstrap_draws": 100, "effects": ["command_delay", "joint_damping"]}'


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A folder with logs, model and report, and what the command printed."""
    folder = tmp_path_factory.mktemp("recommended")
    logs, model = write_parquet(folder / "logs"), write_model(folder)
    (folder / "settings.json").write_text(SETTINGS)
    with pytest.MonkeyPatch.context() as patch:
        said: list[str] = []
        patch.setattr("builtins.print", lambda *parts, **_: said.append(" ".join(map(str, parts))))
        command = ["diagnose", str(logs), str(model), "--out", str(folder / "report"), "--quiet", "--threads", "2"]
        assert cli.main([*command, "--settings", str(folder / "settings.json")]) == 0
    return folder, "\n".join(said)


def recommended(folder: Path) -> Iterator[tuple[Path, str]]:
    """Commands of leapgap in the pages of a report, each with the folder to run it in."""
    for page in sorted(folder.rglob("*.html")):
        for code in re.findall(r"<code[^>]*>(.*?)</code>", page.read_text(), re.DOTALL):
            if html.unescape(code).startswith("leapgap "):
                yield page.parent, html.unescape(code)
    for page in sorted(folder.rglob("*.md")):
        for code in re.findall(r"```bash\n(.*?)```", page.read_text(), re.DOTALL):
            yield from ((page.parent.parent, line) for line in code.splitlines() if line)


def test_every_recommended_command_of_leapgap_runs(written: tuple[Path, str], monkeypatch: pytest.MonkeyPatch) -> None:
    folder, _ = written
    found = list(recommended(folder / "report"))
    assert {Path(place).name for place, _ in found} == {"report"}
    assert len(found) >= 2  # of the page and of corrected/README.md
    for number, (place, command) in enumerate(found):
        assert not re.search(r"[<>]", command), f"{command} is not to be typed as it stands"
        words = [word.replace("LOGS", str(folder / "logs")) for word in shlex.split(command)[1:]]
        words = [f"{folder / 'replays'}_{number}" if word == "replays" else word for word in words]
        monkeypatch.chdir(place)
        assert cli.main(words) == 0, command


def test_the_python_of_the_readme_runs(written: tuple[Path, str], monkeypatch: pytest.MonkeyPatch) -> None:
    folder = written[0] / "report" / "corrected"
    (code,) = re.findall(r"```python\n(.*?)```", (folder / "README.md").read_text(), re.DOTALL)
    monkeypatch.chdir(folder)
    names: dict[str, object] = {}
    exec(code, names)
    assert names["model"].joint("elbow").damping[0] == pytest.approx(0.45, abs=0.02)  # type: ignore[attr-defined]


def test_the_command_ends_with_what_was_written_and_where_each_effect_is(written: tuple[Path, str]) -> None:
    """Each file of the report and of ``corrected/`` by name, no other, and nothing that is not there."""
    folder, said = written
    report, ending = folder / "report", said.split(f"written to {folder / 'report'}:\n")[1].splitlines()
    assert "  joint_damping at elbow: in robot.xml" in ending
    assert ending[-1] == f"page: {report / 'report.html'}"
    files = [line for line in ending if re.match(r" +[\w.]+  ", line)]
    outer, inner = ({line.split()[0] for line in files if re.match(rf" {{{n}}}\S", line)} for n in (2, 4))
    assert outer == {path.name for path in report.iterdir() if not path.name.startswith(".")}
    assert inner == {path.name for path in (report / "corrected").iterdir()}
    absent = dict(re.findall(r"^  no (\S+): (.*)", "\n".join(ending), re.MULTILINE))
    assert set(absent) == set() if find_spec("rerun") else {"diagnosis.rrd"}


def test_what_a_report_lacks_is_said(
    written: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recording where the viewer's package is not there, and a file that its README says why it lacks."""
    folder = Path(shutil.copytree(written[0] / "report", tmp_path / "report"))
    (folder / "diagnosis.rrd").unlink(missing_ok=True)
    (folder / "corrected" / "for_pace.py").unlink()
    monkeypatch.setattr("leapgap.reports.written.find_spec", lambda _: None)
    said = "\n".join(what_was_written(folder))
    assert "no diagnosis.rrd: the viewer's package rerun-sdk is not installed (pip install 'leapgap[view]')" in said
    assert "no corrected/for_pace.py: corrected/README.md says why" in said


def test_the_answer_and_the_best_simulator_have_one_folder_where_they_are_one(written: tuple[Path, str]) -> None:
    report = written[0] / "report"
    assert '"source":"answer"' in (report / "report.json").read_text().replace(" ", "").replace("\n", "")
    assert not (report / "best").exists()
    assert "best/" not in (report / "report.html").read_text()


def test_the_commands_in_refusals_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Logs of another format in a folder whose name has a space; gains that no column tells are asked for."""
    (tmp_path / "my logs").mkdir()
    model = write_model(tmp_path / "my logs")
    logs = write_csv(tmp_path / "my logs" / "swings", 2)
    monkeypatch.chdir(tmp_path)

    def refused(arguments: list[str]) -> list[str]:
        assert cli.main(arguments) == 2
        (command,) = re.findall(r"leapgap (import .*?)(?: > map\.yaml)?; ", capsys.readouterr().err.replace("\n", " "))
        return shlex.split(command)

    command = refused(["check", str(logs), str(model)])
    assert command == ["import", str(logs), str(model), "--out", "imported"]
    for path in logs.iterdir():
        path.write_text("\n".join(",".join(line.split(",")[:5]) for line in path.read_text().splitlines()))
    guess = refused(command)
    assert cli.main(guess) == 0
    assert "format: csv" in capsys.readouterr().out
