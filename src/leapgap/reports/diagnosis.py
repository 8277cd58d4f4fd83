"""A folder of logs diagnosed, and what it comes to written: report, page and corrected robot."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from leapgap.atomic_io import sha256, write_json, write_text
from leapgap.diagnosis.diagnose import Diagnosis, Settings, diagnose
from leapgap.diagnosis.provenance import Provenance
from leapgap.diagnosis.report import Report
from leapgap.logs import log as jump_log
from leapgap.logs.log import Log
from leapgap.reports.report import html
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.corrected import write_corrected
from leapgap.simulation.replay import Replayer


@dataclass(frozen=True)
class DiagnosedLogs:
    """Logs with their diagnosis, and replays of them by name of the log."""

    jumps: tuple[Log, ...]
    robot: Robot
    diagnosis: Diagnosis
    nominal: Mapping[str, Log]
    """Replayed by the nominal robot."""
    corrected: Mapping[str, Log]
    """Replayed with the answer as fitted without the log."""

    @property
    def report(self) -> Report:
        """What the diagnosis says."""
        return self.diagnosis.report

    def write(self, folder: Path) -> None:
        """Write ``report.json``, ``report.html`` and ``corrected/`` into a folder."""
        write_json(folder / "report.json", self.report.to_json())
        write_text(folder / "report.html", html(self.report, self.jumps, self.robot, self.nominal, self.corrected))
        write_corrected(folder / "corrected", self.robot, self.diagnosis.correction)


def diagnose_folder(
    logs: Path,
    robot: Robot,
    settings: Settings,
    progress: Callable[[str], None] = lambda _: None,
    threads: int | None = None,
) -> DiagnosedLogs | None:
    """Diagnose the jump logs of a folder against a robot; None where there are no logs.

    The report's provenance holds names and hashes of the files, and no path. ``threads`` (all cores, where it is None)
    change the time it takes and nothing else.
    """
    jumps = tuple(jump_log.read_logs(logs))
    if not jumps:
        return None
    files = {jump.name: sha256(logs / f"{jump.name}.parquet") for jump in jumps}
    provenance = Provenance.of(jumps, robot, asdict(settings), files)
    diagnosis = diagnose(jumps, robot, settings, provenance, progress=progress, threads=threads)
    replayer = Replayer(robot)

    def replays(motions: Mapping[str, Motion]) -> dict[str, Log]:
        return {jump.name: replayer.as_log(motions[jump.name], jump) for jump in jumps}

    return DiagnosedLogs(jumps, robot, diagnosis, replays(diagnosis.nominal), replays(diagnosis.corrected))
