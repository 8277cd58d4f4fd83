"""Logs diagnosed, and what it comes to: printed, and written as report, page and corrected robot."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from leapgap.diagnosis.departing_logs import check_motion, without_departing
from leapgap.diagnosis.diagnose import Diagnosis, diagnose
from leapgap.diagnosis.localisation import Place
from leapgap.diagnosis.report import Cause, Provenance, ReportContent
from leapgap.diagnosis.settings import Settings
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.export import write_exports
from leapgap.export.base import CorrectedRobot, Posterior, posterior_of
from leapgap.logs.cutting import at_least_two, choose_stretches
from leapgap.logs.log import Log
from leapgap.logs.reach import without_false_stops
from leapgap.logs.reading import Readings, read_folder
from leapgap.logs.state import motion_of
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.robot.picture import Loop, robot_loop, robot_picture
from leapgap.runtime.atomic_io import sha256, write_json, write_text
from leapgap.runtime.blas import one_blas_thread
from leapgap.runtime.output_folder import merged_folder
from leapgap.simulation.corrected import NOMINAL, write_corrected
from leapgap.simulation.replay import Replayer

if TYPE_CHECKING:  # a diagnosis is made without its page, so that a change of the page reruns none
    from leapgap.reports.viewer import EmbeddedViewer

LIGHT, EMBEDDED = "light", "embedded"
VIEWERS = (LIGHT, EMBEDDED)  # what shows the robot on the page: plots and text alone, or the Rerun viewer inside
REPORT, PAGE, CORRECTED, BEST, RECORDING = "report.json", "report.html", "corrected", "best", "diagnosis.rrd"
"""What ``Report.save`` writes into a folder."""
SAVED_BY = "leapgap diagnose"  # what the marker of a saved report says that wrote it
CAUSES_PRINTED = 5
PLACES_PRINTED = 4


@dataclass(frozen=True)
class PageSettings:
    """Section ``report`` of the configuration."""

    viewer: str = LIGHT  # ``light`` or ``embedded``, for the Rerun viewer inside the page
    recordings: bool = True  # whether to write ``diagnosis.rrd``
    diagnosis: str = "data/diagnoses/damped"  # folder of a diagnosis that was kept as data (``kept.keep``)
    out: str | None = None
    replays: str | None = None

    def __post_init__(self) -> None:
        if self.viewer not in VIEWERS:
            raise ValueError(f"viewer {self.viewer}: one of {', '.join(VIEWERS)}")


@dataclass(frozen=True)
class Report:
    """The diagnosis of some logs: print it, look at its parts, or save it."""

    logs: tuple[Log, ...]
    robot: Robot
    diagnosis: Diagnosis
    nominal: Mapping[str, Log]
    """Replays by the nominal robot, by the log's name."""
    corrected: Mapping[str, Log]
    """Replays with the identified causes as fitted without the log, by the log's name."""
    record: Callable[["Report", Path], None] | None = field(default=None, compare=False)
    """Writes a recording of the report, where recordings are wanted."""

    @property
    def content(self) -> ReportContent:
        """All figures of the report."""
        return self.diagnosis.report

    @property
    def verdict(self) -> str:
        """``named``, ``ambiguous``, ``partly``, ``unknown`` or ``none``."""
        return self.content.verdict

    @property
    def sentence(self) -> str:
        """The result in one sentence, with numbers."""
        return self.content.sentence

    @property
    def answer(self) -> tuple[tuple[str, ...], ...]:
        """Names of the identified causes, which act together; names in one group cannot be separated."""
        return self.content.answer

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The identified causes first, then every other effect that was judged, by probability."""
        return self.content.causes

    @property
    def correction(self) -> tuple[Effect, ...]:
        """The identified causes as effects to simulate with, fitted on all logs."""
        return self.diagnosis.correction

    @property
    def best(self) -> tuple[Effect, ...]:
        """The best simulator as effects, fitted on all logs; the identified causes where none was fitted."""
        best = self.content.best_simulator
        return best.effects if best else self.correction

    @property
    def culprits(self) -> tuple[str, ...]:
        """Joints at which the identified causes act, where they do not act at all joints alike."""
        at = [e.location for e in self.correction if e.places == "joints" and e.location != "all"]
        return tuple(dict.fromkeys(joint for one in at for joint in self.robot.topology.joints_at(one)))

    @property
    def posterior(self) -> Posterior:
        """Joint distribution of the identified parameters."""
        fit, causes = self.diagnosis.fit, self.causes[: len(self.answer)]
        return posterior_of(self.robot, self.correction, causes, fit)

    def __str__(self) -> str:
        """The sentence, the gap, the first causes with their numbers, and what could not be judged."""
        content = self.content
        gaps = (content.gap_nominal, content.gap_corrected, content.noise_floor)
        lines = [
            f"{self.verdict}: {self.sentence}",
            "gap {:.3g}, corrected {:.3g}, noise floor {:.3g}".format(*gaps) + f" ({len(self.logs)} logs)",
        ]
        if self.verdict in ("unknown", "partly"):
            lines += largest_errors(content.where)
        lines += [cause_in_words(cause) for cause in self.causes[:CAUSES_PRINTED]]
        if content.best_simulator:
            lines.append(f"best simulator: {content.best_simulator.in_words}")
        lines += [f"external force: {one.in_words}" for one in content.outside_forces]
        lines += [f"check {check.name}: {check.says}" for check in content.checks if not check.passed]
        lines += [f"left out {name}: {reason}" for name, reason in content.set_aside.items()]
        lines += [f"note: {note}" for note in content.notes]
        if content.not_judged:
            lines.append(f"not judged: {'; '.join(content.not_judged)}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        """As it is printed: logs and replays by their values would fill pages of a terminal."""
        return str(self)

    def _repr_html_(self) -> str:
        """What a notebook shows of the report."""
        from leapgap.reports.written import summary_html

        return summary_html(self.content, self.causes[:CAUSES_PRINTED], len(self.logs))

    def save(self, folder: Path | str, viewer: str = LIGHT) -> Path:
        """Write report, page, corrected robot, best simulator and, where Rerun is installed, a recording; the folder.

        Files of an earlier report in the folder are replaced; nothing else in it is touched. A file of yours that has
        the name of one of the report's is an ``InputError``. ``viewer``: ``light``, or ``embedded`` for the Rerun
        viewer inside the page.
        """
        with merged_folder(Path(folder), SAVED_BY, replaced=(CORRECTED, BEST)) as beside:
            self.write(beside, viewer, drawn=True)
            if self.record is not None:
                self.record(self, beside / RECORDING)
        return Path(folder)

    def write(self, folder: Path, viewer: str = LIGHT, drawn: bool = False) -> None:
        """Write ``report.json``, ``report.html``, ``corrected/`` and ``best/`` into a folder.

        ``best/`` is left out where no best simulator was asked for, or where it equals ``corrected/``. ``viewer`` as of
        ``save``; ``drawn``: the page has pictures of the robot and of its motion, where the machine can draw.
        """
        self.write_data(folder)
        self.write_page(folder, viewer, drawn)

    @one_blas_thread()
    def write_data(self, folder: Path) -> None:
        """Write all but the page."""
        write_json(folder / REPORT, self.content.to_json())
        write_corrected(folder / CORRECTED, self.robot, self.correction)
        write_exports(folder / CORRECTED, CorrectedRobot(self.posterior, self.robot, gains_of(self.logs[0])))
        best = self.content.best_simulator
        if best and not best.is_answer:
            write_corrected(folder / BEST, self.robot, self.best)

    @one_blas_thread()
    def write_page(self, folder: Path, viewer: str = LIGHT, drawn: bool = False) -> None:
        """Write the page into a folder that has the data; arguments as of ``write``."""
        from leapgap.reports.report import html

        if viewer not in VIEWERS:
            raise InputError("viewer", viewer, f"one of {', '.join(VIEWERS)}", "choose one of them")
        inside = self.embedded() if viewer == EMBEDDED else None
        picture = robot_picture(self.robot, self.culprits) if drawn and self.culprits else None
        loop = self.loop() if drawn else None
        replays, replayable = (self.nominal, self.corrected), (folder / CORRECTED / NOMINAL).is_file()
        page = html(self.content, self.logs, self.robot, *replays, inside, replayable, picture, loop, self.correction)
        write_text(folder / PAGE, page)

    def loop(self) -> Loop | None:
        """The log of median gap with its replays as a loop; None where the machine cannot draw or there is no gap."""
        name = self.content.median_log
        log = next(one for one in self.logs if one.name == name)
        if self.verdict == "none":
            return None
        motions = [motion_of(log, self.robot), self.diagnosis.nominal[name]]
        motions += [self.diagnosis.corrected[name]] if self.answer else []
        return robot_loop(self.robot, log.time, [motion.qpos for motion in motions])

    def embedded(self) -> "EmbeddedViewer":
        """The viewer with the recording of this report."""
        from leapgap.reports.viewer import embedded_viewer, viewer_folder

        viewer_folder()  # says what is missing before anything is recorded
        if self.record is None:
            expected = "a page with the viewer inside needs Rerun, which writes its recording"
            raise InputError("viewer", "no Rerun", expected, "pip install 'leapgap[view]'")
        with TemporaryDirectory() as folder:
            self.record(self, Path(folder) / RECORDING)
            return embedded_viewer((Path(folder) / RECORDING).read_bytes())


def gains_of(log: Log) -> dict[str, tuple[float, float]]:
    """Gains kp and kd of each joint in the first row of a log."""
    return {joint: (float(log[f"cmd_kp/{joint}"][0]), float(log[f"cmd_kd/{joint}"][0])) for joint in log.joints}


def largest_errors(where: Sequence[Place]) -> list[str]:
    """``errors lie in: elbow velocity, part_1 20 %; …``: the largest places, one line; none where there are none."""
    from leapgap.reports.channels_data import channel_words

    parts = [f"{channel_words(one.channel)}, {one.phase} {100 * one.share:.0f} %" for one in where[:PLACES_PRINTED]]
    return [f"largest errors: {'; '.join(parts)}"] if parts else []


def cause_in_words(cause: Cause) -> str:
    """``  joint_damping at elbow: damping 0.399 N·m·s/rad (0.376 to 0.423), explains 97 %, probability 1.00``."""
    place = "" if cause.location == "all" else f" at {cause.location}"
    numbers = ", ".join(
        f"{name} {one.value:.3g}{'' if one.unit == '1' else f' {one.unit}'} ({one.ci95[0]:.3g} to {one.ci95[1]:.3g})"
        for name, one in cause.parameters.items()
    )
    closes = f"explains {100 * cause.closure.value:z.0f} %, probability {cause.probability:.2f}"
    return f"  {cause.effect}{place}: {numbers}, {closes}"


@dataclass(frozen=True)
class ChosenLogs:
    """The logs that are diagnosed, and what the report says of the others."""

    logs: tuple[Log, ...]
    set_aside: Mapping[str, str]  # name → reason of each log that could not be used, or departs from the others
    left_out: tuple[str, ...]
    """A sentence on stretches or logs that are left out since there are more than a diagnosis can use."""
    notes: tuple[str, ...]  # what is unusual in the logs

    @staticmethod
    def of(readings: Readings, progress: Callable[[str], None] = lambda _: None) -> "ChosenLogs":
        """Logs without those that depart from the others; of more rows than a diagnosis can use, stretches.

        A single long log is cut into parts, so that there are others to judge a cause on. ``progress`` gets what is
        set aside and left out.
        """
        logs, departing = without_departing(readings.logs)
        check_motion(logs)
        chosen, left_out = choose_stretches(logs)
        for line in (*readings.lines(), *map(str, departing), *left_out):
            progress(line)
        aside = {one.name: one.reason for one in (*readings.set_aside, *departing)}
        return ChosenLogs(tuple(at_least_two(chosen)), aside, left_out, readings.notes)


def diagnose_logs(
    logs: Sequence[Log],
    robot: Robot,
    settings: Settings,
    progress: Callable[[str], None] = lambda _: None,
    threads: int | None = None,
) -> Report:
    """Diagnose logs against a robot and replay them; arguments as of ``diagnosis.diagnose``."""
    chosen = ChosenLogs.of(Readings(tuple(logs)), progress)
    return diagnose_chosen(chosen, robot, settings, progress=progress, threads=threads)


@one_blas_thread()
def diagnose_chosen(
    chosen: ChosenLogs,
    robot: Robot,
    settings: Settings,
    own: Sequence[type[Effect]] = (),
    provenance: Provenance | None = None,
    progress: Callable[[str], None] = lambda _: None,
    threads: int | None = None,
    descriptions: Sequence[Robot] = (),
    record: Callable[[Report, Path], None] | None = None,
) -> Report:
    """As ``diagnose_logs``, of logs that are chosen already; ``record`` writes a recording of the report."""
    robot, of_ranges = without_false_stops(chosen.logs, robot)
    descriptions = [without_false_stops(chosen.logs, other)[0] for other in descriptions]
    of_robot = [f"{robot.name}: {note}" for note in (*robot.notes, *of_ranges)]
    for note in of_robot:
        progress(note)
    aside = chosen.set_aside
    diagnosis = diagnose(chosen.logs, robot, settings, provenance, progress, threads, own, descriptions, aside)
    said = (*chosen.left_out, *diagnosis.report.not_judged)
    notes = (*of_robot, *chosen.notes, *diagnosis.report.notes)
    diagnosis = replace(diagnosis, report=replace(diagnosis.report, not_judged=said, notes=notes))
    replayer = Replayer(robot, sensors=diagnosis.sensors)

    def replays(motions: Mapping[str, Motion]) -> dict[str, Log]:
        return {log.name: replayer.as_log(motions[log.name], log) for log in diagnosis.logs}

    nominal, corrected = replays(diagnosis.nominal), replays(diagnosis.corrected)
    return Report(diagnosis.logs, robot, diagnosis, nominal, corrected, record)


def diagnose_folder(
    folder: Path,
    robot: Robot,
    settings: Settings,
    progress: Callable[[str], None] = lambda _: None,
    threads: int | None = None,
    own: Sequence[type[Effect]] = (),
    descriptions: Sequence[Robot] = (),
    record: Callable[[Report, Path], None] | None = None,
) -> Report | None:
    """Diagnose the logs of a folder against a robot; None where there are no logs.

    The report's provenance holds names and hashes of the files, and no path.
    """
    readings = read_folder(folder, robot)
    if not readings.logs:
        return None
    files = {log.name: sha256(folder / f"{log.name}.parquet") for log in readings.logs}
    provenance = Provenance.of(readings.logs, robot, asdict(settings), files)
    chosen = ChosenLogs.of(readings, progress)
    del readings  # so that logs that are not diagnosed leave the memory
    return diagnose_chosen(chosen, robot, settings, own, provenance, progress, threads, descriptions, record)
