"""The command ``leapgap``: the instrument for people who do not write Python.

Exit code 0: done. Exit code 2: bad input, with one message that says where, what was found, what was expected and what
to do. Lengths are in m, angles in rad, times in s, forces in N and torques in N·m throughout.
"""

import argparse
import os
import re
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path
from typing import Any, NoReturn, TextIO

import leapgap as lg
from leapgap.errors import InputError, did_you_mean, printable
from leapgap.runtime.interrupt import STOPPED
from leapgap.runtime.output_folder import check_output, merged_folder, system_error, what_is_kept
from leapgap.runtime.processes import Begins, InterruptGuard, open_closed_streams, still_running, tolerate_terminal

DESCRIPTION = "Find out why a robot does not move as its MuJoCo simulation does."
IMPORT, REPLAY, DEMO, NET = "leapgap import", "leapgap replay", "leapgap demo", "leapgap actuator-net"
"""Commands, as the markers of their output folders name them."""
MOST_THREADS = 1024
DIR: dict[str, Any] = {"type": Path, "metavar": "DIR"}
FILE: dict[str, Any] = {"type": Path, "metavar": "FILE"}
UNITS = "Units: m, rad, s, N, N·m.\nExit code 2: bad input, with a message that says what to do."
EXAMPLES = {
    "diagnose": (
        "leapgap diagnose logs robot.xml --out report",
        "leapgap diagnose logs robot.xml --effects joint_friction,joint_damping --threads 4",
    ),
    "judge": ("leapgap judge report further_logs", "leapgap judge identified.xml further_logs --nominal robot.xml"),
    "compare": ("leapgap compare logs_before logs_after robot.xml",),
    "actuator-net": ("leapgap actuator-net logs robot.xml --out networks --report report",),
    "consequence": ("leapgap consequence report --policy policy.onnx --map policy.yaml",),
    "check": ("leapgap check logs robot.xml",),
    "replay": (
        "leapgap replay logs report/corrected --out replays",
        "leapgap replay logs robot.xml --effect joint_damping@elbow:damping=0.4 --out replays",
    ),
    "import": (
        "leapgap import --guess my_logs robot.xml > map.yaml",
        "leapgap import my_logs robot.xml --options map.yaml --out logs",
    ),
    "effects": ("leapgap effects robot.xml",),
    "report": ("leapgap report report --no-browser",),
    "demo": ("leapgap demo --number 4",),
}
"""Of each command, calls of it."""
BEGINS: dict[str, Begins] = {
    "diagnose": {2: (0.02, 0.1), 3: (0.4, 0.95), 4: (0.75, 0.97)},
    "check": {2: (0.3, 0.7)},
    "import": {},
    "judge": {},
    "compare": {},
}
"""Shares of a command's time at which its steps begin, as seen on arms, a servo arm and quadrupeds."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; its exit code."""
    if arguments is None:  # the command itself, not a call from Python
        open_closed_streams()
        InterruptGuard(lambda: f"leapgap: stopped by Ctrl-C; {what_is_kept()}").install()
        tolerate_terminal()
    chosen, unknown = parser().parse_known_args(arguments)
    if unknown:  # said by the command, whose usage names what it takes
        chosen.parser.error(f"unrecognized arguments: {' '.join(unknown)}")
    try:
        chosen.run(chosen)
        sys.stdout.flush()
    except InputError as error:
        tell(f"leapgap {chosen.command}: {error}", sys.stderr)
        return 2
    except BrokenPipeError:  # the reader of a pipe, such as `head`, has enough; Python must not flush into it at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        tell(f"leapgap {chosen.command}: {system_error(error)}", sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"leapgap {chosen.command}: stopped", file=sys.stderr)
        return STOPPED
    return 0


def tell(text: object, to: TextIO | None = None) -> None:
    """Print lines for a terminal: control characters, which names in foreign files may hold, become their codes."""
    print("\n".join(map(printable, str(text).split("\n"))), file=to or sys.stdout, flush=True)


def parser() -> argparse.ArgumentParser:
    """All commands and their options."""
    lines = argparse.RawDescriptionHelpFormatter
    further = "\n\n'leapgap COMMAND --help' has the options of a command, with examples."
    top = Parser(prog="leapgap", description=DESCRIPTION, epilog=f"{UNITS}{further}", formatter_class=lines)
    top.add_argument("--version", action=Version, nargs=0, help="print the version and end")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, run: Any, says: str) -> argparse.ArgumentParser:
        examples = "\n".join(["examples:", *(f"  {example}" for example in EXAMPLES[name]), "", UNITS])
        added = commands.add_parser(name, help=says, description=says, epilog=examples, formatter_class=lines)
        added.set_defaults(run=run, parser=added)
        return added

    diagnose = command("diagnose", run_diagnose, "diagnose logs against a MuJoCo model and write a report")
    diagnose.add_argument("logs", type=Path, help="folder of logs in leapgap's format (*.parquet)")
    diagnose.add_argument("robot", type=Path, help="model of the robot (MJCF or URDF)")
    diagnose.add_argument("--out", **DIR, help="folder for report and corrected model; default: none")
    diagnose.add_argument("--effects", metavar="A,B", help="search these effects only (list: leapgap effects)")
    diagnose.add_argument("--without", metavar="A,B", help="leave these effects out")
    diagnose.add_argument("--settings", **FILE, help="settings to change, JSON or YAML")
    diagnose.add_argument(
        "--viewer",
        choices=("light", "embedded"),
        default="light",
        help="embedded: the Rerun viewer inside the page, 25 MB in place of 3 MB",
    )
    diagnose.add_argument("--threads", type=count, metavar="N", help="number of threads; default: all cores")
    diagnose.add_argument("--quiet", action="store_true", help="print the result only, no progress")
    robot_options(diagnose)

    judge = command("judge", run_judge, "say which changes of a corrected model are supported by further logs")
    judge.add_argument("correction", type=Path, help="corrected model file of any tool, or the folder of a report")
    judge.add_argument("logs", type=Path, help="folder of logs (*.parquet) that it was not fitted on, two or more")
    judge.add_argument(
        "--nominal", dest="robot", type=Path, metavar="ROBOT", help="the model that the file corrects; a report has it"
    )
    judge_options(judge)

    compare = command("compare", run_compare, "say what changed between two sets of logs of one robot")
    compare.add_argument("before", type=Path, help="folder of logs (*.parquet), two or more")
    compare.add_argument("after", type=Path, help="folder of logs after the change, two or more, of like motions")
    compare.add_argument(
        "robot", type=Path, help="model of the robot (MJCF or URDF); its errors that are in both sets cancel"
    )
    judge_options(compare)

    net = command(
        "actuator-net", run_actuator_net, "train actuator networks from logs, and compare them with identified causes"
    )
    net.add_argument("logs", type=Path, help="folder of logs (*.parquet), two or more, of one set of gains")
    net.add_argument("robot", type=Path, help="model of the robot (MJCF or URDF)")
    net.add_argument("--out", **DIR, required=True, help="folder for the networks")
    net.add_argument("--report", **DIR, help="report whose causes the networks are compared with")
    net.add_argument("--history", type=count, default=3, metavar="N", help="steps that a network sees: 3")
    net.add_argument("--step", type=float, default=0.005, metavar="S", help="length of a step, s: 0.005")
    net.add_argument("--quiet", action="store_true", help="print the errors only, no progress")
    robot_options(net)

    policy = command("consequence", run_consequence, "say what each cause of a report does to a policy")
    policy.add_argument("report", type=Path, help="folder that 'leapgap diagnose --out' wrote, or its folder corrected")
    policy.add_argument("--policy", **FILE, required=True, help="policy as ONNX or TorchScript")
    policy.add_argument("--map", **FILE, required=True, help="its inputs and outputs, YAML or JSON")
    policy.add_argument("--json", **FILE, help="write the result as JSON, too")
    policy.add_argument("--quiet", action="store_true", help="print the result only, no progress")

    check = command("check", run_check, "check time stamps and consistency of logs, in seconds")
    check.add_argument("logs", type=Path, help="folder of logs in leapgap's format (*.parquet)")
    check.add_argument("robot", type=Path, nargs="?", help="model of the robot, for the checks that need one")
    robot_options(check)

    replay = command("replay", run_replay, "replay the logged commands in simulation and write the replays as logs")
    replay.add_argument("logs", type=Path, help="folder of logs in leapgap's format (*.parquet)")
    replay.add_argument("robot", type=Path, help="model of the robot, or the folder 'corrected' of a report")
    replay.add_argument("--out", **DIR, required=True, help="folder for the replays")
    replay.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME[@PLACE]:PARAMETER=VALUE,…",
        help="add an effect, such as joint_damping@RR_calf:damping=0.4; may be repeated",
    )
    robot_options(replay)

    bring = command("import", run_import, "convert logs of another format to leapgap's format")
    bring.add_argument("source", type=Path, help="folder that holds the logs, or one file")
    bring.add_argument("robot", type=Path, help="model of the robot (MJCF or URDF)")
    bring.add_argument("--format", help="csv, json, parquet, npz, hdf5, mat, pt, ros, lerobot, sage, …; default: any")
    bring.add_argument("--out", **DIR, help="folder for the logs")
    bring.add_argument(
        "--guess", action="store_true", help="suggest a column mapping for these logs as YAML; import nothing"
    )
    bring.add_argument(
        "--options",
        **FILE,
        help="column mapping, YAML or JSON; default: the suggested one, if it leaves no question open",
    )
    robot_options(bring)

    effects = command("effects", run_effects, "list the effects that can be searched, with units and ranges")
    effects.add_argument("robot", type=Path, nargs="?", help="model of the robot: gives nominal values and ranges")
    robot_options(effects)

    report = command("report", run_report, "print the result of a report and open its page")
    report.add_argument("folder", type=Path, help="folder that 'leapgap diagnose --out' wrote")
    report.add_argument("--no-browser", action="store_true", help="do not open the page")

    demo = command("demo", run_demo, "diagnose a simulated robot with a hidden fault; a minute or two")
    demo.add_argument("--out", **DIR, default=Path("demo"), help="folder for logs and report: demo")
    demo.add_argument("--number", type=int, default=3, metavar="N", help="which robot; each has another fault: 3")
    demo.add_argument("--no-browser", action="store_true", help="do not open the page")
    return top


def judge_options(command: argparse.ArgumentParser) -> None:
    """Options that ``judge`` and ``compare`` share."""
    command.add_argument("--json", **FILE, help="write the result as JSON, too")
    command.add_argument("--settings", **FILE, help="settings to change, JSON or YAML")
    command.add_argument("--threads", type=count, metavar="N", help="number of threads; default: all cores")
    command.add_argument("--quiet", action="store_true", help="print the result only, no progress")
    robot_options(command)


def robot_options(command: argparse.ArgumentParser) -> None:
    """Options of a command that say how the model file of the robot is read."""
    command.add_argument(
        "--fix-base",
        action=argparse.BooleanOptionalAction,
        help="hold a floating base at the pose of the model; --no-fix-base lets a URDF float",
    )
    command.add_argument("--feet", metavar="A,B", help="geoms or sites that are feet; default: named spheres")


def robot_of(chosen: argparse.Namespace) -> Any:
    """The robot that a command names, with notes on its model file printed; None where it names none."""
    robot = load_robot(chosen)
    for note in robot.notes if robot else ():
        tell(f"{robot.path}: {note}", sys.stderr)
    return robot


def load_robot(chosen: argparse.Namespace) -> Any:
    """The robot that a command names; None where it names none."""
    if chosen.robot is None:
        return None
    from leapgap.robot.model import Robot
    from leapgap.robot.topology import PartNames

    names = PartNames(feet=tuple(chosen.feet.split(","))) if chosen.feet else None
    return Robot.load(chosen.robot, names=names, fix_base=chosen.fix_base)


def count(text: str) -> int:
    """A number of threads: a whole number from 1 to ``MOST_THREADS``."""
    number = int(text) if text.isdecimal() and len(text) < 10 else 0
    if not 1 <= number <= MOST_THREADS:
        raise argparse.ArgumentTypeError(f"found {text}; expected 1 to {MOST_THREADS}")
    return number


class Parser(argparse.ArgumentParser):
    """A parser whose errors name the nearest word that is known."""

    def error(self, message: str) -> NoReturn:
        """Print the usage, the message and the nearest known word; end with exit code 2."""
        words = [word for group in re.findall(r"choose from ([^)]*)", message) for word in re.findall(r"[\w-]+", group)]
        words += [*self._option_string_actions, *(action.dest for action in self._actions if not action.option_strings)]
        unknown = re.search(r"(?:invalid choice: '|unrecognized arguments: )([^' ]+)", message)
        nearest = did_you_mean(unknown[1], words) if unknown else None
        super().error(f"{message}; {nearest}" if nearest else message)


class Version(argparse.Action):
    """Print the version of the installed package."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        """Print the installed version and end the command with exit code 0."""
        print(f"leapgap {lg.__version__}")
        parser.exit()


def run_diagnose(chosen: argparse.Namespace) -> None:
    """Diagnose, print the result, write the report where a folder is named."""
    from leapgap.reports.diagnosis import SAVED_BY

    if chosen.out is not None:
        check_output(chosen.out, SAVED_BY, (chosen.logs, chosen.robot), kept=True)
    if chosen.viewer == "embedded":
        from leapgap.reports.viewer import viewer_folder

        viewer_folder()  # what is missing is said before the work begins
    settings = settings_of(chosen)
    effects, without = names_in(chosen.effects), names_in(chosen.without)
    with told_on_the_way(chosen) as progress:
        robot = load_robot(chosen)
        progress(f"{robot.path.name}: {robot.step_and_integrator}")
        report = lg.diagnose(chosen.logs, robot, settings, effects, progress, chosen.threads, without=without)
        tell(f"\n{report}" if not chosen.quiet else report)
        if chosen.out is not None:
            progress("step 4 of 4, report")
            print_written(report.save(chosen.out, chosen.viewer))


def names_in(text: str | None) -> list[str]:
    """Names in a list such as ``a,b``; none where there is no text."""
    return [name.strip() for name in (text or "").split(",") if name.strip()]


def run_consequence(chosen: argparse.Namespace) -> None:
    """Print what each cause of a report does to a policy."""
    from leapgap.learning.consequence import PolicyMap, consequence, read_policy
    from leapgap.settings import from_json
    from leapgap.simulation.corrected import corrected_in, read_corrected

    map = from_json(PolicyMap, chosen.map)
    robot, causes = read_corrected(corrected_in(chosen.report))
    network = read_policy(chosen.policy)
    tell_result(chosen, lambda progress: consequence(robot, causes, network, map, progress))


def run_judge(chosen: argparse.Namespace) -> None:
    """Print what further logs say of each change of a corrected model."""
    settings, robot = settings_of(chosen), robot_of(chosen)
    tell_result(
        chosen, lambda progress: lg.judge(chosen.correction, chosen.logs, robot, settings, progress, chosen.threads)
    )


def run_compare(chosen: argparse.Namespace) -> None:
    """Print what changed between two sets of logs."""
    settings, robot = settings_of(chosen), robot_of(chosen)
    tell_result(
        chosen, lambda progress: lg.compare(chosen.before, chosen.after, robot, settings, progress, chosen.threads)
    )


def run_actuator_net(chosen: argparse.Namespace) -> None:
    """Train a network for each joint group, print its error beside those of the joint PD and of named causes."""
    from importlib.util import find_spec

    from leapgap.runtime.output_folder import whole_folder
    from leapgap.simulation.corrected import read_corrected

    if find_spec("torch") is None or find_spec("onnx") is None:
        raise InputError("import of torch", "no such package", "the extra learning", "pip install 'leapgap[learning]'")
    if not 1e-5 <= chosen.step <= 1.0:
        raise InputError("--step", f"{chosen.step:g} s", "0.00001 to 1 s", "name the physics step of your simulator")
    from leapgap.learning.actuator_network import train_networks

    check_output(chosen.out, NET, (chosen.logs, chosen.robot))
    causes = None if chosen.report is None else read_corrected(chosen.report / "corrected")[1]
    robot = robot_of(chosen)
    with told_on_the_way(chosen) as progress:
        logs = lg.read_logs(chosen.logs, robot=robot)
        found = train_networks(logs, robot, causes, chosen.history, chosen.step, progress=progress)
    with whole_folder(chosen.out, NET) as beside:
        found.write(beside)
    tell(found)
    tell(f"networks: {chosen.out}")


def tell_result(chosen: argparse.Namespace, work: Any) -> None:
    """Print what ``work`` finds, and write it as JSON where a file is named."""
    from leapgap.runtime.atomic_io import write_json

    if chosen.json is not None and not chosen.json.parent.is_dir():
        raise InputError(chosen.json, "no such folder", "a file in a folder that exists", "make the folder")
    with told_on_the_way(chosen) as progress:
        found = work(progress)
    tell(found)
    if chosen.json is not None:
        write_json(chosen.json, found.to_json())
        tell(f"as data: {chosen.json}")


def told_on_the_way(chosen: argparse.Namespace) -> AbstractContextManager[Callable[[str], None]]:
    """What prints the progress of a command for the time of a block; nothing with ``--quiet``."""
    return nullcontext(lambda _: None) if chosen.quiet else still_running(tell, BEGINS.get(chosen.command))


def told_at_terminal(chosen: argparse.Namespace) -> AbstractContextManager[Callable[[str], None]]:
    """What prints the progress of a quick command, where a person sits at a terminal; programs get results alone."""
    if not sys.stderr.isatty():
        return nullcontext(lambda _: None)
    return still_running(partial(tell, to=sys.stderr), BEGINS[chosen.command])


def settings_of(chosen: argparse.Namespace) -> Any:
    """Settings of a diagnosis from the file that a command names; those that were validated, if it names none."""
    from leapgap.diagnosis.settings import Settings
    from leapgap.settings import from_json

    return from_json(Settings, chosen.settings) if chosen.settings else Settings()


def print_written(folder: Path) -> None:
    """Print what a report's folder holds, and where its page is."""
    from leapgap.reports.written import what_was_written

    tell("\n".join([*what_was_written(folder), f"page: {folder / 'report.html'}"]))


def run_check(chosen: argparse.Namespace) -> None:
    """Print each check on a line."""
    with told_at_terminal(chosen) as progress:
        progress("step 1 of 2, reading")
        robot = robot_of(chosen)
        logs = lg.read_logs(chosen.logs, robot=robot)
        progress(f"step 2 of 2, checks: {len(logs)} logs, {sum(map(len, logs))} samples")
        found = lg.check(logs, robot)
    tell(found)


def run_replay(chosen: argparse.Namespace) -> None:
    """Replay the logs and write the replays."""
    from leapgap import effects

    check_output(chosen.out, REPLAY, (chosen.logs, chosen.robot), kept=True)
    added = tuple(effects.from_config([effect_entry(text)])[0] for text in chosen.effect)
    replays = lg.replay(chosen.logs, chosen.robot if chosen.robot.is_dir() else robot_of(chosen), added)
    write_all(replays, chosen.out, REPLAY)
    tell(f"{len(replays)} replays: {chosen.out}")


def write_all(logs: Sequence[Any], folder: Path, by: str) -> None:
    """Write logs into a folder, beside those that the same command wrote before; one of the same name is replaced."""
    with merged_folder(folder, by) as beside:
        for log in logs:
            lg.write_log(log, beside / f"{log.name}.parquet")


def effect_entry(text: str) -> dict[str, Any]:
    """``joint_damping@RR_calf:damping=0.4`` as an entry of a configuration."""
    head, _, values = text.partition(":")
    name, _, place = head.partition("@")
    entry: dict[str, Any] = {"name": name, "location": place or "all"}
    for pair in filter(None, values.split(",")):
        key, equals, value = pair.partition("=")
        if key.strip() in entry:
            raise InputError("--effect", f"{key.strip()} twice", "each parameter once", "leave one out")
        try:
            entry[key.strip()] = float(value)
        except ValueError:
            found = f"{pair!r}" if equals else f"{pair!r} without a value"
            raise InputError("--effect", found, "PARAMETER=NUMBER", "write it as damping=0.4") from None
    return entry


def run_import(chosen: argparse.Namespace) -> None:
    """Read all logs of the source, then write them; or print a map that would read them."""
    from leapgap.api import read_foreign
    from leapgap.logs.importers import log_format
    from leapgap.logs.map_proposal.report import propose_map
    from leapgap.settings import from_mapping

    if chosen.guess:
        robot = robot_of(chosen)
        tell(propose_map(chosen.source, robot, chosen.format).text(robot))
        return
    if chosen.out is None:
        raise InputError("--out", "no folder", "a folder for the logs", "name it: --out DIR")
    check_output(chosen.out, IMPORT, (chosen.source, chosen.robot), kept=True)
    guessed: list[str] = []
    values: Any
    with told_at_terminal(chosen) as progress:
        progress(f"step 1 of 2, reading {chosen.source}")
        if chosen.options is None and is_proposed(chosen.format):
            found = propose_map(chosen.source, load_robot(chosen), chosen.format)
            name, values = found.format, found.answered(chosen.source, chosen.robot)
            guessed = [f"guessed: {sentence}" for sentence in found.guesses]
        else:
            name, values = import_options(chosen.options, chosen.format)
        options: Any = None if values is None else from_mapping(log_format(name).Options, values, str(chosen.options))
        readings = read_foreign(chosen.source, name, robot_of(chosen), options)
        logs = readings.logs
        progress(f"step 2 of 2, writing {len(logs)} logs")
        write_all(logs, chosen.out, IMPORT)
    for line in (*guessed, *readings.lines()):
        tell(line, sys.stderr)
    for log in logs:
        tell(import_line(log))
    tell(f"{len(logs)} logs: {chosen.out}")


def is_proposed(format: str | None) -> bool:
    """Whether a map can be proposed for a format: for tables; None stands for whichever the files are of."""
    from leapgap.logs.importers import log_format
    from leapgap.logs.importers.table_format import TableFormat

    return format is None or isinstance(log_format(format), TableFormat)


def import_options(path: Path | None, stated: str | None) -> tuple[str, Any]:
    """Format and options of an import: the file holds the options alone, or the format beside its section."""
    from leapgap.settings import values_of

    values = None if path is None else values_of(path)
    if isinstance(values, dict) and isinstance(values.get("format"), str):
        stated = stated or values["format"]
        values = values.get(stated) or {}
    if stated is None:
        do = "name it: --format csv, or format: csv in the options"
        raise InputError("--format", "no format", "the format of the logs", do)
    return stated, values


def import_line(log: Any) -> str:
    """What came of one log: its length, its clock, and what in it is computed."""
    notes = [f"{key}: {how}" for key, how in log.info.extra.get("derived", {}).items()]
    follows = log.info.extra.get("follows", {}).items()
    notes += [f"{joint} is not in the file: it follows {other}, to which the model ties it" for joint, other in follows]
    if not log.info.extra.get("gains", {}).get("known", True):
        notes.append("gains of the joint PD unknown: those in the log are a first guess")
    head = f"{log.name}: {len(log)} samples, {log.time[-1]:.3f} s, mean step {1e3 * log.info.sample_period_s:.4g} ms"
    return "; ".join([head, *notes])


def run_effects(chosen: argparse.Namespace) -> None:
    """Print a line for each parameter of each effect."""
    from leapgap.reports.written import effect_rows

    robot = robot_of(chosen)
    rows = effect_rows(robot)
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        tell("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    if robot:
        tell(f"{robot.path}: {robot.step_and_integrator}", sys.stderr)


def run_report(chosen: argparse.Namespace) -> None:
    """Print the sentence; open the page in the browser unless that is not wanted."""
    from leapgap.runtime.atomic_io import read_json

    data, page = chosen.folder / "report.json", chosen.folder / "report.html"
    if not data.is_file() or not page.is_file():
        found = "no report.json with a report.html" if chosen.folder.is_dir() else "no such folder"
        raise InputError(chosen.folder, found, "a folder that 'leapgap diagnose --out' wrote", "name that folder")
    sentence = read_json(data).get("sentence")
    if not isinstance(sentence, str):
        raise InputError(data, "no sentence", "a report", "name a folder that 'leapgap diagnose --out' wrote")
    tell(printable(sentence))
    tell(f"page: {page}")
    if not chosen.no_browser:
        open_page(page)


def open_page(page: Path) -> None:
    """Open a page in the browser."""
    import webbrowser

    webbrowser.open(page.resolve().as_uri())


def run_demo(chosen: argparse.Namespace) -> None:
    """Simulate a robot with a hidden effect, diagnose its logs, say what it was, open the page."""
    from leapgap import demo
    from leapgap.reports.diagnosis import SAVED_BY

    logs_folder, report_folder = chosen.out / "logs", chosen.out / "report"
    check_output(logs_folder, DEMO, kept=True)
    check_output(report_folder, SAVED_BY, kept=True)
    hiding = demo.simulate(chosen.number)
    write_all(hiding.logs, logs_folder, DEMO)
    tell(f"simulated robot {chosen.number} with a hidden fault: {len(hiding.logs)} logs in {logs_folder}")
    with still_running(tell, BEGINS["diagnose"]) as progress:
        report = lg.diagnose(logs_folder, hiding.robot, progress=progress)
        tell(f"\n{report}\n\nhidden was {hiding.answer}\n")
        progress("step 4 of 4, report")
        print_written(report.save(report_folder))
    if not chosen.no_browser:
        open_page(report_folder / "report.html")


if __name__ == "__main__":
    sys.exit(main())
