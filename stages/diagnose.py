"""The diagnosis of a folder of jump logs against a robot."""

from functools import partial
from pathlib import Path

from omegaconf import DictConfig

from leapgap.atomic_io import whole_folder, write_json, write_text
from leapgap.diagnosis.diagnose import Settings
from leapgap.logs import log as jump_log
from leapgap.reports.diagnosis import DiagnosedLogs, diagnose_folder
from leapgap.reports.log_recording import DIAGNOSED, GHOSTS, record_jump
from leapgap.robot.model import Robot
from stages.common import output_folder, read_config, run_stage


def diagnose(config: DictConfig) -> None:
    """Judge the logs, then write report, corrected robot, replays and recording, all or nothing."""
    section = config.diagnose
    settings = read_config(Settings, section.settings, "diagnose.settings")
    robot = Robot.load(section.robot or config.robot.model)
    logs, out = Path(section.logs), output_folder(section.out)
    replays = Path(section.replays) if section.replays else out / "replays"
    found = diagnose_folder(logs, robot, settings, partial(print, flush=True), section.threads)
    if found is None:
        print(f"no logs in {logs}: nothing to diagnose")
        for folder in (out, replays):
            with whole_folder(folder) as empty:
                write_text(empty / "no_logs.txt", "There were no jump logs to diagnose.\n")
        return
    with whole_folder(out) as folder:
        found.write(folder)
        if section.recordings:
            record(found, folder / "diagnosis.rrd")
    with whole_folder(replays) as folder:
        write_replays(found, folder)
    if section.metrics:
        write_json(Path(section.metrics), found.report.metrics())
    print(found.report.sentence)
    print(f"report: {out / 'report.html'}")


def record(found: DiagnosedLogs, path: Path) -> None:
    """Record the median log beside its replays, in one scene."""
    report = found.report
    shown = next(jump for jump in found.jumps if jump.name == report.median_log)
    replays = {"nominal": found.nominal, "corrected": found.corrected}
    beside = {name: replays[kind][shown.name] for kind, name in GHOSTS.items()}
    record_jump(path, shown, found.robot, beside, title=f"diagnosis of {shown.name}", says=report.sentence)


def write_replays(found: DiagnosedLogs, folder: Path) -> None:
    """Write the replays of all logs as jump logs, and which log is the median one."""
    write_json(folder / DIAGNOSED, {"log": found.report.median_log, "sentence": found.report.sentence})
    for kind, replays in (("nominal", found.nominal), ("corrected", found.corrected)):
        for name, replay in replays.items():
            jump_log.write_log(replay, folder / kind / f"{name}.parquet")


if __name__ == "__main__":
    run_stage(diagnose)
