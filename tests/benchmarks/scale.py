"""How do time and memory grow with the number of jumps and with the length of logs?

Jumps of the A1 with joint damping of 0.3 N·m·s/rad go through ``chunk``, ``train`` and ``diagnose``; logs of a two-link
arm of up to ten minutes at 1 kHz go through ``diagnose``. Each part is a process of its own, whose time and largest
memory are those of the whole command, start and imports included. Run as ``python -m tests.benchmarks.scale --json
<file>``; what the file already has is not measured again. ``--table`` prints the file as Markdown.
"""

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from leapgap.effects.friction import JointDamping
from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.planning.reference import reference_to
from leapgap.jumping.task import Target
from leapgap.logs.log import Log, write_log
from leapgap.logs.schema import PAIR_FORCE_AXES
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import write_json
from leapgap.simulation.open_loop import Course, MotionPlan, run_open_loop
from leapgap.simulation.sensors import SensorNoise
from tests.benchmarks import run_benchmark
from tests.code import ROOT

JUMPS = (16, 64, 128, 500)
MINUTES = (1, 3, 10)
MODELS = "[nominal_fitted,kernel,networks]"
LIMIT_S = 3600


@dataclass(frozen=True)
class Part:
    """One command on one input."""

    name: str
    size: int
    arguments: tuple[str, ...]
    make: Callable[[Path], object]
    """Makes the inputs in a folder."""


def make_jumps(folder: Path, number: int) -> None:
    """Write jumps of the A1 on a robot whose joints are damped more than its model's."""
    robot = Robot.load()
    plan = reference_to(Target(0.6), folder / "references", planar_robot(robot))
    plans = [MotionPlan(f"jump_{i:03d}", plan) for i in range(number)]
    rng = np.random.default_rng(number)
    for begin in range(0, number, 50):
        some = plans[begin : begin + 50]
        for log in run_open_loop(some, robot, (JointDamping(damping=0.3),), SensorNoise(), Course(), rng):
            zeros = {f"pd_force/{axis}": np.zeros(len(log)) for axis in PAIR_FORCE_AXES}
            whole = Log(log.name, {**log.columns, **zeros}, replace(log.info, robot=robot.name))
            write_log(whole, folder / "jumps" / f"{log.name}.parquet")


def make_arm_logs(folder: Path, minutes: int) -> None:
    """Write two logs of an arm, by plain MuJoCo."""
    code = (
        "import sys; from pathlib import Path; sys.path.insert(0, 'docs/examples'); import arm_logs; "
        f"arm_logs.LENGTH_S = {60 * minutes}.0; arm_logs.main(Path({str(folder)!r}), logs=2)"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def parts(folder: Path) -> list[Part]:
    """All parts, with inputs in a folder."""
    found = []
    for number in JUMPS:
        own = folder / f"{number}_jumps"

        def jumps(_: Path, own: Path = own, number: int = number) -> None:
            if not (own / "jumps").is_dir():
                make_jumps(own, number)

        train = ("train.sessions=null", f"train.models={MODELS}", "train.processes=1", f"train.out={own}/models")
        stages = {
            "chunk": (f"chunk.logs={own}/jumps", f"chunk.out={own}/windows"),
            "train": (f"train.windows={own}/windows", *train),
            "diagnose": (f"diagnose.logs={own}/jumps", f"diagnose.out={own}/report", "diagnose.recordings=false"),
        }
        found += [Part(name, number, ("-m", f"stages.{name}", *of), jumps) for name, of in stages.items()]
    for minutes in MINUTES:
        own = folder / f"{minutes}_minutes"

        def logs(_: Path, own: Path = own, minutes: int = minutes) -> None:
            if not (own / "logs").is_dir():
                make_arm_logs(own, minutes)

        command = ("-m", "leapgap.cli", "diagnose", f"{own}/logs", f"{own}/robot.xml", "--out", f"{own}/report")
        found.append(Part("diagnose_minutes", minutes, command, logs))
    return found


def measure(arguments: Sequence[str]) -> dict[str, float]:
    """Seconds, seconds of all processors and largest memory of a command, MB."""
    environment = dict(os.environ, PYTHONPATH=str(ROOT / "src"))
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    code = (
        "import resource, subprocess, sys\n"
        "done = subprocess.run([sys.executable, *sys.argv[1:]], timeout=" + str(LIMIT_S) + ")\n"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss, file=sys.stderr)\n"
        "sys.exit(done.returncode)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(arguments)}: {done.stderr[-3000:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    peak_mb = int(done.stderr.split()[-1]) / 1024
    return {"seconds": round(time.monotonic() - began, 1), "cpu_s": round(cpu_s, 1), "peak_mb": round(peak_mb)}


def table(figures: dict) -> str:
    """The figures as a table in Markdown."""
    lines = ["| command | input | seconds | CPU seconds | peak, MB |", "|---|---|---:|---:|---:|"]
    for name, by_size in figures["parts"].items():
        for size, one in by_size.items():
            kind = f"2 logs of {size} min at 1 kHz" if name == "diagnose_minutes" else f"{size} jumps"
            command = "leapgap diagnose" if name == "diagnose_minutes" else name
            lines.append(f"| `{command}` | {kind} | {one['seconds']:g} | {one['cpu_s']:g} | {one['peak_mb']:g} |")
    return "\n".join(lines)


def main() -> None:
    """Measure what is not measured yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, default=ROOT / "metrics" / "timing" / "scale.json")
    parser.add_argument("--work", type=Path, default=None, help="folder of the inputs, kept; default: a temporary one")
    parser.add_argument("--only", default="", help="names of parts, such as chunk:500,diagnose_minutes:10")
    parser.add_argument("--table", action="store_true", help="print the table of the file and measure nothing")
    parser.add_argument("--tiny", action="store_true", help="the smallest part alone; what it measures means nothing")
    chosen = parser.parse_args()
    if chosen.tiny:
        chosen.only = f"chunk:{JUMPS[0]}"
    known = json.loads(chosen.json.read_text(encoding="utf-8")) if chosen.json.is_file() else {"parts": {}}
    if chosen.table:
        print(table(known))
        return
    with tempfile.TemporaryDirectory() as temporary:
        for part in parts(chosen.work or Path(temporary)):
            wanted = not chosen.only or f"{part.name}:{part.size}" in chosen.only.split(",")
            if not wanted or str(part.size) in known["parts"].get(part.name, {}):
                continue
            part.make(chosen.work or Path(temporary))
            one = measure(part.arguments)
            known["parts"].setdefault(part.name, {})[str(part.size)] = one
            write_json(chosen.json, {"machine": f"{platform.machine()}, {os.cpu_count()} cores", **known})
            print(part.name, part.size, one, flush=True)


if __name__ == "__main__":
    run_benchmark(main)
