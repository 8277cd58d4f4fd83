"""What a model file asks for is bounded before MuJoCo reads it: a file of ten lines can ask for all memory there is.

It is counted in a process of its own (``model_count``). A model that is large, or of elements whose cost cannot be
counted, is compiled once in another such process, which may take ``TRIAL_S`` of a processor and ``TRIAL_BYTES``. Bounds
are far above any robot: they separate a model from an accident or an attack. Files that a model names may lie anywhere,
as those of real robots do, but each must be a plain file of bounded size: no pipe, device or folder.
"""

import hashlib
import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from leapgap.errors import InputError, check_utf8
from leapgap.robot import model_count
from leapgap.robot.model_count import A_MODEL, DO, LARGEST_MODEL_BYTES, RefusedError, plain_size, signature_of

TRIAL_S, TRIAL_BYTES = 60, 4 << 30  # time of a processor and addresses that compiling an unusual model may take
WAIT = 3  # how much longer a process may take by the clock than by its processor, which it shares
TRIAL = """
import json, sys
asked = json.load(sys.stdin)
sys.path[:] = asked["packages"]
from leapgap.robot.model_count import limit_process
import mujoco
limit_process(asked["memory_bytes"], asked["time_s"])
try:
    text = asked["text"]
    spec = mujoco.MjSpec.from_file(asked["path"]) if text is None else mujoco.MjSpec.from_string(text)
    model = spec.compile()
except MemoryError:
    print(float("inf"))
except Exception as error:
    print(float("inf") if "allocate memory" in str(error) else 0)
else:
    print(int(model.nbuffer) + int(model.narena))
"""
"""Compiles a model and prints its bytes. One that does not compile is told by whoever reads it."""
PASSED: dict[tuple[str, str], Mapping[str, Any]] = {}
"""Path and hash of a text that passed in this process → where its files were looked for, and what was there."""


def check_model_file(path: Path) -> str:
    """The text of a model file, MJCF or URDF; ``InputError`` where it is none, or asks for too much."""
    check_utf8(path)
    try:
        if path.exists():
            plain_size(path, path, model_count.LARGEST_XML_BYTES)
        data = path.read_bytes() if path.exists() else b""
    except RefusedError as refused:
        raise InputError(*refused.parts) from None
    except OSError as error:
        raise InputError(path, f"a file that cannot be read ({error.strerror})", A_MODEL, DO) from None
    check(path, None, hashlib.sha256(data).hexdigest())
    return data.decode(errors="replace")


def check_text(text: str, path: Path) -> None:
    """Raise ``InputError`` for the text of a model file, read as if at ``path``, that asks for too much."""
    check(path, text, hashlib.sha256(text.encode(errors="surrogateescape")).hexdigest())


def check(path: Path, text: str | None, digest: str) -> None:
    """Count a model, and compile an unusual one, in processes of their own, unless the same passed before."""
    key = (str(path), f"{digest}{text is not None}")
    if key in PASSED and all(signature_of(Path(one)) == was for one, was in PASSED[key].items()):
        return
    said = counted(path, text)
    if "refused" in said:
        raise InputError(*said["refused"])
    if not said["ordinary"] and (text is not None or said["top"] != "robot"):
        try_to_compile(path, text)
    PASSED[key] = said["tried"]


def counted(path: Path, text: str | None) -> dict[str, Any]:
    """What ``model_count`` says of a model."""
    asked = {"path": str(path), "text": text}
    if not sys.executable:  # Python inside another program: no process to be had
        return model_count.answer(asked)
    asked_by = f"import sys; sys.path.append({str(Path(__file__).parent)!r}); import model_count; model_count.main()"
    said = ask([sys.executable, "-I", "-S", "-c", asked_by], asked, model_count.TIME_S)
    if said is None:
        limits = f"{model_count.TIME_S} s and {model_count.MEMORY_BYTES >> 20} MiB at most to read it"
        raise InputError(path, "a model that takes more time or memory than any robot's", limits, DO)
    return dict(json.loads(said))


def try_to_compile(path: Path, text: str | None) -> None:
    """Raise ``InputError`` for a model that takes too much time or memory to compile, or ends its process."""
    if not sys.executable:
        return
    asked = {"path": str(path), "text": text, "packages": sys.path, "memory_bytes": TRIAL_BYTES, "time_s": TRIAL_S}
    said = ask([sys.executable, "-I", "-S", "-c", TRIAL], asked, TRIAL_S)
    size = float(said) if said else float("inf")
    if not size <= LARGEST_MODEL_BYTES:
        found = f"a model of {size / (1 << 20):.0f} MiB"
        if size == float("inf"):
            found = "a model that takes more memory or time than any robot's"
        limits = f"{LARGEST_MODEL_BYTES >> 20} MiB compiled, in {TRIAL_S} s at most"
        raise InputError(path, found, limits, "make it smaller")


def ask(command: list[str], asked: Mapping[str, Any], time_s: int) -> str | None:
    """What a process answers on its standard output; None where it ends otherwise, or not in time."""
    try:
        done = subprocess.run(
            command,
            input=json.dumps(asked).encode(),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=WAIT * time_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return None
    return done.stdout.decode() if done.returncode == 0 and done.stdout else None
