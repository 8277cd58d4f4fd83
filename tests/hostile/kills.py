"""Kills: each stage that has workers is killed in the middle of its work, and run again.

What is looked for afterwards: half-written outputs, processes that live on, and bytes that differ from those of a run
that nobody killed. A stage is killed several times before it may end, so that runs that go on after a kill are killed,
too.
"""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from leapgap.logs import log as jump_log
from leapgap.robot.model import Robot
from tests.code import ROOT
from tests.commands import environment, python
from tests.conftest import standing

SOON_S = 3.0
"""Time in which a command must have ended after Ctrl-C."""
LATEST = 0.95
"""Kills come up to this share of the time that a whole run takes from the begin of its workers."""
AT_ONCE = 3
"""Kills of a stage before it may end."""
ORPHAN_S = 15.0
"""Time after which a process without its parent counts as an orphan: a process that was killed still needs a processor
to end, and on a busy machine waits for it."""


@dataclass(frozen=True)
class StageCall:
    """A stage with workers at tiny size."""

    name: str
    arguments: tuple[str, ...]
    """``{out}`` is the folder of its output, ``{inputs}`` that of its inputs."""
    workers: int = 2
    """Processes that it starts."""


TINY = ("size=tiny", "executor=joblib", "executor.workers=2")
LAND = ("land.methods=[joint_pd,nominal_variable]", "land.tasks.block_60.repeats=2", "land.tasks.jump_50.repeats=2")
TRAIN = ("size=tiny", "train.models=[networks]", "train.sessions=null", "train.folds=2")
WITHHOLD = ("withhold.references={inputs}/references", "withhold.published=null")
NO_OTHERS = ("withhold.halves.reported.nameless=0", "withhold.halves.reported.none=0")
QUICK = ("best=false", "folds=2", "most_pieces=6")
ALONE = ("diagnose_withheld.settings.effects=[joint_damping]", *(f"diagnose.settings.{setting}" for setting in QUICK))
"""Diagnoses that take seconds, of one effect."""
MISSED_LOGS = "diagnose_withheld.logs={inputs}/missed/logs"
REVISIT = (
    *("revisit.logs={inputs}/missed/logs", "revisit.truth={inputs}/missed/truth", "revisit.verdicts={inputs}/verdicts"),
    *("revisit.references={inputs}/references", "revisit.missed=2", "revisit.further=['collect.jumps=1']"),
)
REFERENCES = "references={inputs}/references"
CALLS = (
    StageCall("collect", (*TINY, "collect.jumps=8", f"collect.{REFERENCES}", "collect.out={out}")),
    StageCall("land", (*TINY, *LAND, f"land.{REFERENCES}", "land.out={out}")),
    StageCall("practise", (*TINY, "land.methods=[learned_variable]", f"land.{REFERENCES}", "practise.out={out}")),
    StageCall("train", (*TRAIN, "train.windows={inputs}/windows", "train.out={out}")),
    StageCall("withhold", (*TINY, *WITHHOLD, "withhold.logs={out}/logs", "withhold.truth={out}/truth")),
    StageCall("diagnose_withheld", (*TINY, *ALONE, MISSED_LOGS, "diagnose_withheld.out={out}")),
    StageCall("revisit", (*TINY, *ALONE, *REVISIT, "revisit.out={out}")),
    StageCall(
        "export", (*TINY, "export.landings=null", "export.target=[0.45,0.0]", f"land.{REFERENCES}", "export.out={out}")
    ),
)
MISSED = (
    *("withhold.logs={out}/logs", "withhold.truth={out}/truth", "withhold.world.jumps=2"),
    *("withhold.halves.tuning.single=3", *NO_OTHERS),
)
"""Cases of single effects; two of the three are detectable, and missed by a diagnosis that looks for one other."""


def command(call: StageCall, inputs: Path, out: Path) -> list[str]:
    """The command line of a call."""
    filled = [argument.format(inputs=inputs, out=out) for argument in call.arguments]
    return [sys.executable, "-m", f"stages.{call.name}", *filled]


def run(call: StageCall, inputs: Path, out: Path) -> None:
    """Run a call to its end."""
    done = python(*command(call, inputs, out)[1:])
    assert done.returncode == 0, done.stderr[-3000:]


def prepare(inputs: Path, names: Sequence[str] = tuple(call.name for call in CALLS)) -> None:
    """Make the inputs of the stages: plans, windows and withheld cases."""
    references = inputs / "references"
    targets = "optimize.targets=[[0.4,0.0],[0.45,0.0],[0.5,0.0]]"
    run(StageCall("optimize", ("optimize.planar=own", targets, f"optimize.out={references}")), inputs, references)
    if "train" in names:
        robot = Robot.load()
        for i in range(4):
            log = standing(robot, 1300)
            columns = dict(log.columns)
            force = {
                f"train_force/{pair}_{axis}": columns["time"] * (10 + i) for pair in ("front", "rear") for axis in "xz"
            }
            jump_log.write_log(
                jump_log.Log(f"jump_{i}", columns | force, log.info), inputs / "jumps" / f"jump_{i}.parquet"
            )
        logs, windows = inputs / "jumps", inputs / "windows"
        run(StageCall("chunk", (f"chunk.logs={logs}", f"chunk.out={windows}")), inputs, windows)
    if {"diagnose_withheld", "revisit"} & set(names):
        run(StageCall("withhold", (*TINY, *WITHHOLD, *MISSED)), inputs, inputs / "missed")
    if "revisit" in names:
        (call,) = (one for one in CALLS if one.name == "diagnose_withheld")
        run(call, inputs, inputs / "verdicts")


class Running:
    """A stage in a session of its own, with everything that it started."""

    def __init__(self, call: StageCall, inputs: Path, out: Path) -> None:
        self.process = subprocess.Popen(
            command(call, inputs, out),
            cwd=ROOT,
            env=environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )

    def members(self) -> list[int]:
        """Living processes of its session, helpers that only clean up left out."""
        return [pid for pid in session_members(self.process.pid) if not is_helper(pid)]

    def wait_for(self, count: int, timeout_s: float = 60.0) -> bool:
        """Wait until it has that many workers at work; False where it ended before."""
        end = time.monotonic() + timeout_s
        while time.monotonic() < end and self.process.poll() is None:
            if len(self.workers()) >= count:
                return True
            time.sleep(0.005)
        return False

    def wait_for_end(self, timeout_s: float) -> None:
        """Wait until it ends, for some time at most."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.communicate(timeout=timeout_s)

    def workers(self) -> list[int]:
        """Living processes that it started, without those that wait for its end to clean up."""
        return [pid for pid in self.members() if pid != self.process.pid and not mentions(pid, "guardian.py")]

    def kill_all(self) -> None:
        """End whatever is left of it."""
        for pid in session_members(self.process.pid):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def left_after(self, seconds: float) -> list[int]:
        """Processes that still live after that time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and self.members():
            time.sleep(0.02)
        return self.members()


def session_members(session: int) -> list[int]:
    """Processes of a session that are no zombies."""
    found = []
    for path in Path("/proc").iterdir():
        if path.name.isdigit():
            with contextlib.suppress(OSError):
                state, *rest = (path / "stat").read_text().rpartition(")")[2].split()
                if int(rest[2]) == session and state not in "ZX":
                    found.append(int(path.name))
    return found


def is_helper(pid: int) -> bool:
    """Whether a process is one that only clears shared memory and ends by itself with the last of the others."""
    return mentions(pid, "resource_tracker")


def mentions(pid: int, word: str) -> bool:
    """Whether a word stands in the command line of a process; True where the process is gone."""
    with contextlib.suppress(OSError):
        return word in Path(f"/proc/{pid}/cmdline").read_text()
    return True


def files(out: Path) -> dict[str, bytes]:
    """Every file below an output folder, with its bytes."""
    return {p.relative_to(out).as_posix(): p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()}


@dataclass
class KillTally:
    """What many kills came to."""

    kills: int = 0
    partial_visible: int = 0
    orphans: int = 0
    bytes_differ: int = 0


def kill_and_resume(
    call: StageCall, inputs: Path, folder: Path, expected: dict[str, bytes], *moments_s: float
) -> KillTally:
    """Kill a stage so long after its workers began, run it again and kill it at the next moment; then let it end."""
    out, tally = folder / "out", KillTally()
    for moment_s in moments_s:
        while not kill_once(call, inputs, out, expected, moment_s, tally):
            # It had ended before. What an earlier kill had left would end sooner still, so it begins anew.
            tally.bytes_differ += files(out) != expected
            shutil.rmtree(out)
            moment_s /= 2
    run(call, inputs, out)
    tally.bytes_differ += files(out) != expected
    if tally == KillTally(tally.kills):
        shutil.rmtree(folder)  # else it is kept for whoever looks for the cause
    return tally


def kill_once(
    call: StageCall, inputs: Path, out: Path, expected: dict[str, bytes], after_s: float, tally: KillTally
) -> bool:
    """Kill a stage some time after its workers began and look around; False where it ended before."""
    running = Running(call, inputs, out)
    try:
        if running.wait_for(call.workers):
            running.wait_for_end(after_s)
        running.process.kill()  # nothing, where it has ended, be it while we asked
        ended = running.process.wait()
        assert ended in (0, -signal.SIGKILL), f"{call.name} failed after a kill with {ended}"
        killed = ended == -signal.SIGKILL
        tally.orphans += len(running.left_after(ORPHAN_S))
    finally:
        running.kill_all()
    tally.kills += killed
    tally.partial_visible += sum(1 for name, data in visible(out).items() if expected.get(name) != data)
    return killed


def visible(out: Path) -> dict[str, bytes]:
    """What a reader of an output would take for a result: files whose names are not hidden, in folders likewise."""
    found = files(out) if out.is_dir() else {}
    return {name: data for name, data in found.items() if not any(part.startswith(".") for part in name.split("/"))}


def stage_and_moments(number: int) -> tuple[str, list[float]]:
    """A stage, and the moments at which it is killed, as shares of the time that its workers take.

    Moments of one stage are spread evenly, however many there are: each is a golden section further, round and round.
    """
    earlier = number // len(CALLS) * AT_ONCE
    return CALLS[number % len(CALLS)].name, [(0.618 * (earlier + k)) % 1.0 * LATEST for k in range(AT_ONCE)]


def kills_number(number: int, folder: Path) -> KillTally:
    """The kills of that number, at moments of their own; inputs and whole outputs in ``folder`` are made if missing."""
    name, moments = stage_and_moments(number)
    (call,) = (one for one in CALLS if one.name == name)
    inputs, whole = folder / "inputs", folder / call.name
    if not (folder / "ready").exists():
        shutil.rmtree(folder, ignore_errors=True)
        prepare(inputs)
        (folder / "ready").touch()
    if not (whole / "ready").exists():
        shutil.rmtree(whole, ignore_errors=True)
        lasts_s = working_time(call, inputs, whole / "out")
        (whole / "ready").write_text(str(lasts_s))
    lasts_s = float((whole / "ready").read_text())
    killed = folder / f"kills_{number}"
    shutil.rmtree(killed, ignore_errors=True)
    return kill_and_resume(call, inputs, killed, files(whole / "out"), *(share * lasts_s for share in moments))


def working_time(call: StageCall, inputs: Path, out: Path) -> float:
    """Run a call to its end; how long it took from the begin of its workers, s."""
    running = Running(call, inputs, out)
    try:
        assert running.wait_for(call.workers), "the stage has no workers"
        began = time.monotonic()
        _, said = running.process.communicate()
        assert running.process.returncode == 0, said[-3000:]
        return time.monotonic() - began
    finally:
        running.kill_all()
