"""The public names and the command, on logs of a small arm that plain MuJoCo made."""

import json
import re
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import leapgap as lg
from leapgap import cli
from leapgap.effects.base import parameter
from leapgap.logs.metadata import Segment
from tests import plain_arm

PUBLIC = (
    *("Robot", "Log", "read_logs", "write_log", "replay", "check", "diagnose", "Report", "Settings", "Effect"),
    *("effects", "__version__"),
)
"""As the contract lists them."""
EXTRAS = {
    *("casadi", "daqp", "dvc", "h5py", "hydra", "joblib", "lightning", "mujoco_menagerie", "omegaconf"),
    *("onnx", "onnxruntime", "osqp", "rerun", "rosbags", "torch"),
}
"""Modules that extras bring, and that are imported where they are used."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the arm's model and its logs, as Parquet and as a stranger's CSV."""
    path = tmp_path_factory.mktemp("arm")
    plain_arm.write_model(path)
    plain_arm.write_parquet(path / "logs")
    plain_arm.write_csv(path / "tables")
    return path


@pytest.fixture(scope="module")
def report(folder: Path) -> lg.Report:
    return lg.diagnose(lg.read_logs(folder / "logs"), folder / "arm.xml")


def test_public_names_are_there_and_no_heavy_library_is_imported() -> None:
    code = f"""
import sys, time
begin = time.perf_counter()
import leapgap
assert time.perf_counter() - begin < 0.5
for name in {PUBLIC}:
    assert name in dir(leapgap)
heavy = {EXTRAS | {"mujoco", "scipy", "plotly"}} & set(sys.modules)
assert not heavy, heavy
for name in {PUBLIC}:
    getattr(leapgap, name)
heavy = {EXTRAS} & set(sys.modules)
assert not heavy, heavy
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_unknown_name_lists_the_public_ones() -> None:
    with pytest.raises(AttributeError, match="no attribute 'diagnosis_of'; public are Effect, InputError, Log"):
        lg.diagnosis_of  # type: ignore[attr-defined]  # noqa: B018


def test_five_lines_find_what_the_arm_hides(report: lg.Report) -> None:
    assert report.verdict == "named"
    assert report.answer == (("joint_damping",),)
    cause = report.causes[0]
    assert cause.location == "elbow"
    damping = cause.parameters["damping"]
    hidden = plain_arm.TRUE - plain_arm.BELIEVED
    assert damping.value == pytest.approx(hidden, rel=0.05)
    assert damping.ci95[0] < hidden < damping.ci95[1]
    assert cause.closure.value > 0.9
    (effect,) = report.correction
    assert effect.location == "elbow"


def test_printed_it_says_sentence_gap_and_numbers(report: lg.Report) -> None:
    lines = str(report).splitlines()
    assert lines[0] == f"named: {report.sentence}"
    assert "viscous friction (joint_damping at elbow: damping 0." in lines[0]
    assert lines[1].startswith("gap 0.29") and lines[1].endswith("(4 logs)")
    assert lines[2].startswith("  joint_damping at elbow: damping 0.") and "N·m·s/rad" in lines[2]


def test_saved_it_is_a_page_a_file_of_figures_and_a_robot_to_simulate_with(
    folder: Path, report: lg.Report, tmp_path: Path
) -> None:
    (tmp_path / "mine.txt").write_text("not the report's")
    assert report.save(tmp_path) == tmp_path
    data = json.loads((tmp_path / "report.json").read_text())
    assert data["verdict"] == "named" and data["sentence"] == report.sentence
    assert set(data["provenance"]["logs"]) == {f"swing_{i}" for i in range(4)}
    page = (tmp_path / "report.html").read_text()
    assert report.sentence.split(" (")[0][1:] in page
    assert "elbow position, rms error" in page  # without a base, the joints are shown
    assert (tmp_path / "diagnosis.rrd").stat().st_size > 1000
    assert (tmp_path / "mine.txt").read_text() == "not the report's"
    corrected = json.loads((tmp_path / "corrected" / "effects.json").read_text())
    assert corrected["effects"][0]["name"] == "joint_damping"


def test_the_page_of_an_arm_speaks_of_joints_and_not_of_jumps(report: lg.Report, tmp_path: Path) -> None:
    words = words_of(report.save(tmp_path))
    assert not re.search(r"\b(jump|leg|foot|feet|trunk|phase|collect)", words, flags=re.IGNORECASE)
    assert "part 1 elbow velocity" in words  # the table's words are those of the curves
    assert "leapgap replay" in words
    assert "corrected, not fitted on this log" in words


def test_sentences_of_the_page_stand_apart_where_logs_have_segments(report: lg.Report, tmp_path: Path) -> None:
    parts = sorted({place.phase for place in report.content.where})
    stated = tuple(Segment(name, 0.5 * i, 0.5 * (i + 1)) for i, name in enumerate(parts))
    logs = [replace(log, info=replace(log.info, stated_segments=stated)) for log in report.logs]
    words = words_of(replace(report, logs=logs).save(tmp_path))
    assert re.search(r"Dotted lines: where segments of the log begin \([\w, ]+\)\.", words)


def words_of(folder: Path) -> str:
    """The words of a report's page, without scripts and marks."""
    page = (folder / "report.html").read_text()
    text = re.sub(r"<script.*?</script>|<style.*?</style>", "", page, flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]+>", " ", text).split())


def test_the_corrected_replay_is_nearer_to_the_log(folder: Path, report: lg.Report) -> None:
    logs = lg.read_logs(folder / "logs")
    nominal = lg.replay(logs, folder / "arm.xml")
    corrected = lg.replay(logs, folder / "arm.xml", report.correction)

    def missed(replays: list[lg.Log]) -> float:
        pairs = zip(replays, logs, strict=True)
        return float(np.mean([np.abs(r["joint_pos/elbow"] - log["joint_pos/elbow"]).mean() for r, log in pairs]))

    assert missed(corrected) < 0.1 * missed(nominal)


def test_logs_read_written_and_read_again_are_the_same(folder: Path, tmp_path: Path) -> None:
    log = lg.read_logs(folder / "logs" / "swing_0.parquet")[0]
    path = lg.write_log(log, tmp_path / "again.parquet")
    (again,) = lg.read_logs(path)
    assert again.columns.keys() == log.columns.keys()
    assert all(np.array_equal(again[name], log[name]) for name in log.columns)
    assert again.info == log.info


def test_a_csv_of_a_stranger_is_read_by_a_map_of_columns(folder: Path) -> None:
    from leapgap.logs.importers import log_format

    names = ("joint_pos", "joint_vel", "cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")
    options = log_format("csv").Options(columns={f"{name}/*": f"{name}_*" for name in names})
    logs = lg.read_logs(folder / "tables", "csv", folder / "arm.xml", options)
    (parquet,) = lg.read_logs(folder / "logs" / "swing_0.parquet")
    assert np.abs(logs[0]["joint_pos/elbow"] - parquet["joint_pos/elbow"]).max() < 1e-12
    assert len(logs) == 4


def test_checks_need_no_robot(folder: Path) -> None:
    alone, with_robot = lg.check(folder / "logs"), lg.check(folder / "logs", folder / "arm.xml")
    names = [one.name for one in alone.results]
    assert names == ["velocity_channel", "row_clock", "joint_clock", "even_clock", "set_points"]
    assert alone.passed and with_robot.passed
    assert str(alone).startswith("passed  velocity_channel: joint velocities match the derivative of the positions")
    assert "passed  row_clock: samples are evenly spaced" in str(alone)
    assert "passed  joint_clock: positions of the joints agree with their velocities" in str(alone)


def test_checks_of_rows_that_are_sampled_at_once_solve_no_sparse_equations(folder: Path) -> None:
    """Importing ``scipy.sparse`` takes a third of the time of such a check."""
    code = f"import sys, leapgap; leapgap.check({str(folder / 'logs')!r}); assert 'scipy.sparse' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_slow_clock_is_seen_without_a_robot(folder: Path, tmp_path: Path) -> None:
    """Rows that lasted 1.1 ms under a claim of 1 ms: joints move 10 % further than their velocities allow."""
    for i in range(2):
        columns = plain_arm.swing(i)
        slow = {name: values[::11] for name, values in columns.items()} | {"time": np.arange(0, 2000, 11) * 0.01 / 10}
        slow["time"] = np.arange(len(slow["joint_pos/elbow"])) * 0.010
        source = lg.read_logs(folder / "logs" / f"swing_{i}.parquet")[0]
        info = type(source.info)(**{**vars(source.info), "sample_period_s": 0.010})
        lg.write_log(lg.Log(f"slow_{i}", slow, info), tmp_path / f"slow_{i}.parquet")
    found = {one.name: one for one in lg.check(tmp_path).results}
    assert not found["joint_clock"].passed
    assert found["joint_clock"].statistic == pytest.approx(0.1, abs=0.01)


@dataclass(frozen=True)
class Counterweight(lg.Effect):
    """A spring that pulls a joint back to zero."""

    name = "counterweight"
    places = "joints"

    stiffness: float = parameter(0.0, "N·m/rad", 0.0, 50.0, 2.0)

    def change_model(self, model: mujoco.MjModel, robot: lg.Robot) -> None:
        """Add to the stiffness of the joints."""
        for dof in robot.joint_dofs[robot.joints_at(self.location)]:
            model.jnt_stiffness[model.dof_jntid[dof]] += self.stiffness


def test_an_effect_of_the_users_own_is_judged_beside_ours(folder: Path) -> None:
    report = lg.diagnose(
        folder / "logs", folder / "arm.xml", lg.Settings(effects=["joint_damping"]), effects=[Counterweight]
    )
    assert report.answer == (("joint_damping",),)
    assert "counterweight" in {cause.effect for cause in report.causes}


def test_effects_mean_in_a_call_what_they_mean_in_the_command(folder: Path) -> None:
    report = lg.diagnose(
        folder / "logs", folder / "arm.xml", effects=["joint_damping", "armature"], without=["armature"]
    )
    assert {cause.effect for cause in report.causes} == {"joint_damping"}
    cause = report.causes[0]
    low, high = cause.parameters["damping"].interval
    assert (cause.effect, cause.location) == ("joint_damping", "elbow") and low < cause.parameters[
        "damping"
    ].value < high
    assert repr(report) == str(report)
    shown = report._repr_html_()
    assert shown.startswith("<p><b>named</b>: viscous friction") and "<td>elbow</td><td>damping</td>" in shown
    with pytest.raises(lg.InputError, match=r"effects: found joint_dampng; .*did you mean joint_damping\?"):
        lg.diagnose(folder / "logs", folder / "arm.xml", effects=["joint_dampng"])
    with pytest.raises(lg.InputError, match=r"did you mean joint_damping\?"):
        lg.effects.effect("joint_dampin")


def run(*arguments: object) -> int:
    return cli.main([str(one) for one in arguments])


def test_the_command_from_a_csv_to_a_report(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = ("joint_pos", "joint_vel", "cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")
    (tmp_path / "map.json").write_text(json.dumps({"columns": {f"{name}/*": f"{name}_*" for name in names}}))
    arm, logs, out = folder / "arm.xml", tmp_path / "logs", tmp_path / "report"
    options = ("--format", "csv", "--out", logs, "--options", tmp_path / "map.json")
    assert run("import", folder / "tables", arm, *options) == 0
    assert run("check", logs, arm) == 0
    assert run("diagnose", logs, arm, "--out", out, "--effects", "joint_damping,joint_friction", "--quiet") == 0
    said = capsys.readouterr().out
    assert "4 logs:" in said and "passed  joint_clock" in said
    assert "named: viscous friction (joint_damping at elbow: damping 0." in said
    assert run("report", out, "--no-browser") == 0
    assert str(out / "report.html") in capsys.readouterr().out
    replays = tmp_path / "replays"
    assert run("replay", logs, out / "corrected", "--out", replays) == 0
    assert run("replay", logs, arm, "--effect", "joint_damping@elbow:damping=0.4", "--out", replays) == 0
    assert len(list(replays.glob("*.parquet"))) == 4


def test_an_effect_that_is_left_out_is_not_looked_for(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    both = ("--effects", "joint_damping,joint_friction")
    assert run("diagnose", folder / "logs", folder / "arm.xml", *both, "--without", "joint_damping", "--quiet") == 0
    said = capsys.readouterr().out
    assert "joint_friction" in said and "joint_damping" not in said
    assert not said.startswith("named")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("diagnose", "{folder}/none", "{folder}/arm.xml"), "no such file"),
        (("diagnose", "{folder}", "{folder}/arm.xml"), "found no *.parquet; expected one log or more"),
        (("diagnose", "{folder}/logs", "{folder}/none.xml"), "found no such file; expected a MuJoCo model"),
        (("diagnose", "{folder}/logs", "{folder}/arm.xml", "--effects", "rust"), "found rust; expected names that"),
        (("diagnose", "{folder}/logs", "{folder}/arm.xml", "--without", "rust"), "found rust; expected names that"),
        (("replay", "{folder}/logs", "{folder}/arm.xml", "--out", "x", "--effect", "rust:a=1"), "found rust"),
        (("replay", "{folder}/logs", "{folder}/arm.xml", "--out", "x", "--effect", "payload:kg"), "without a value"),
        (("import", "{folder}/tables", "{folder}/arm.xml", "--format", "bags", "--out", "x"), "one of csv"),
        (("report", "{folder}/logs"), "found no report.json with a report.html"),
    ],
)
def test_bad_input_is_one_message_and_exit_code_2(
    folder: Path, arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*(one.format(folder=folder) for one in arguments)) == 2
    said = capsys.readouterr().err
    assert message in said
    assert len(said.splitlines()) == 1


def test_an_unknown_option_is_said_beside_the_usage_of_its_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run("diagnose", "logs", "--robot", "arm.xml")
    said = capsys.readouterr().err
    assert ended.value.code == 2
    assert said.startswith("usage: leapgap diagnose") and "logs robot" in said
    assert "unrecognized arguments: --robot; did you mean robot?" in said


def test_a_misspelt_setting_is_named(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "settings.json").write_text('{"joint": {"step": 3}}')
    assert run("diagnose", folder / "logs", folder / "arm.xml", "--settings", tmp_path / "settings.json") == 2
    assert "settings.json, joint: found the keys step; expected keys among" in capsys.readouterr().err
    (tmp_path / "settings.json").write_text('{"folds": "four"}')
    assert run("diagnose", folder / "logs", folder / "arm.xml", "--settings", tmp_path / "settings.json") == 2
    assert "settings.json, folds: found 'four'; expected a value of type int" in capsys.readouterr().err


def test_the_table_of_effects_reads_values_from_the_robot(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("effects", folder / "arm.xml") == 0
    table = capsys.readouterr().out
    assert "needs a free base" in table  # foot_friction of an arm
    assert "needs constants of its motors" in table
    assert "-0.05 to 6" in table  # damping: down to none of the model's own, up to a tenth of the motors' 60 N·m
    named = {line.split()[0] for line in table.splitlines() if line.endswith("(searched if named)")}
    uneven = {line.split()[0] for line in table.splitlines() if line.endswith("named, or with uneven time stamps)")}
    assert uneven == {"computation_delay", "velocity_filter"}
    assert named | uneven == {name for name, kind in lg.effects.known().items() if not kind.by_default}


def test_every_command_has_help(capsys: pytest.CaptureFixture[str]) -> None:
    words = "diagnose judge compare actuator-net consequence check replay import effects report"
    for command in words.split():
        with pytest.raises(SystemExit) as end:
            run(command, "--help")
        assert end.value.code == 0
        assert "Units: m, rad, s, N" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        run("--version")
    assert capsys.readouterr().out == f"leapgap {lg.__version__}\n"


def test_the_command_hangs_a_robot_up_and_takes_feet_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "ball.xml").write_text("""<mujoco model="ball"><worldbody><body name="ball"><freejoint/>
      <geom name="skin" type="box" size="0.1 0.1 0.1"/><site name="pole" pos="0 0 -0.1"/>
      <body><joint name="arm"/><geom size="0.1" mass="1"/></body></body></worldbody>
      <actuator><motor joint="arm"/></actuator></mujoco>""")

    def lines(*options: str) -> dict[str, str]:
        assert cli.main(["effects", str(tmp_path / "ball.xml"), *options]) == 0
        printed = capsys.readouterr()
        assert ("the model has no ground" in printed.err) == ("--fix-base" not in options)
        return {line.split()[0]: line for line in printed.out.splitlines()}

    assert "needs feet" in lines()["foot_friction"]
    assert "needs" not in lines("--feet", "pole")["foot_friction"]
    assert "needs a free base" in lines("--fix-base")["payload"]
