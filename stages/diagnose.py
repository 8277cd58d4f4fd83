"""The diagnosis of a folder of jump logs against a robot."""

from dataclasses import asdict
from functools import partial
from pathlib import Path

from omegaconf import DictConfig

from leapgap.diagnosis.diagnose import Settings
from leapgap.diagnosis.diagnose import diagnose as run_diagnosis
from leapgap.diagnosis.provenance import Provenance
from leapgap.files import sha256, whole_folder, write_json, write_text
from leapgap.recording import jump as jump_log
from leapgap.robot.model import Robot
from leapgap.simulation.corrected import write_corrected
from leapgap.simulation.replay import Replayer
from leapgap.view.gallery import DIAGNOSED, GHOSTS
from leapgap.view.jump import record_jump
from leapgap.view.report import html
from stages.common import output_folder, read_config, run_stage


def diagnose(config: DictConfig) -> None:
    """Judge the logs, then write report, corrected robot, replays and recording, all or nothing."""
    section = config.diagnose
    settings = read_config(Settings, section.settings, "diagnose.settings")
    robot = Robot.load(section.robot or config.robot.model)
    logs = Path(section.logs)
    jumps = jump_log.read_folder(logs)
    out = output_folder(section.out)
    replays = Path(section.replays) if section.replays else out / "replays"
    if not jumps:
        print(f"no logs in {logs}: nothing to diagnose")
        for folder in (out, replays):
            with whole_folder(folder) as empty:
                write_text(empty / "no_logs.txt", "There were no jump logs to diagnose.\n")
        return
    files = {jump.name: sha256(logs / f"{jump.name}.parquet") for jump in jumps}
    provenance = Provenance.of(jumps, robot, asdict(settings), files)
    tell = partial(print, flush=True)
    found = run_diagnosis(jumps, robot, settings, provenance, progress=tell, threads=section.threads)
    report, replayer = found.report, Replayer(robot)
    ghosts = {
        kind: {jump.name: replayer.as_jump(motions[jump.name], jump) for jump in jumps}
        for kind, motions in (("nominal", found.nominal), ("corrected", found.corrected))
    }
    with whole_folder(out) as folder:
        write_json(folder / "report.json", report.to_json())
        write_text(folder / "report.html", html(report, jumps, robot, ghosts["nominal"], ghosts["corrected"]))
        write_corrected(folder / "corrected", robot, found.correction)
        if section.recordings:
            shown = next(jump for jump in jumps if jump.name == report.median_log)
            beside = {name: ghosts[kind][shown.name] for kind, name in GHOSTS.items()}
            record_jump(
                folder / "diagnosis.rrd", shown, robot, beside, title=f"diagnosis of {shown.name}", says=report.sentence
            )
    with whole_folder(replays) as folder:
        write_json(folder / DIAGNOSED, {"log": report.median_log, "sentence": report.sentence})
        for kind, of_kind in ghosts.items():
            for name, ghost in of_kind.items():
                jump_log.write(ghost, folder / kind / f"{name}.parquet")
    if section.metrics:
        write_json(Path(section.metrics), report.metrics())
    print(report.sentence)
    print(f"report: {out / 'report.html'}")


if __name__ == "__main__":
    run_stage(diagnose)
