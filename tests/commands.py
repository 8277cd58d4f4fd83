"""Commands in processes of their own, as a user calls them."""

import os
import subprocess
import sys
from pathlib import Path

from tests.code import ROOT


def environment(**variables: str) -> dict[str, str]:
    """Variables for a command that is called by hand: this tree's library and stages, none of DVC's, and these."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("DVC_")}
    path = os.pathsep.join(filter(None, (str(ROOT), str(ROOT / "src"), os.environ.get("PYTHONPATH"))))
    return kept | {"PYTHONPATH": path} | variables


def python(
    *arguments: object, cwd: Path = ROOT, most_bytes: int | None = None, **variables: str
) -> subprocess.CompletedProcess[str]:
    """Run Python. ``most_bytes`` of a file: what is larger fails as on a full disk."""

    def limit() -> None:
        import resource

        if most_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, most_bytes))

    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=cwd,
        env=environment(**variables),
        capture_output=True,
        text=True,
        preexec_fn=limit,
        check=False,
    )


def stage(name: str, *arguments: object, cwd: Path = ROOT, **more: str) -> subprocess.CompletedProcess[str]:
    """What came of a stage that ran in a process of its own, without the settings of this one."""
    return python("-m", f"stages.{name}", *arguments, cwd=cwd, **more)


def assert_refused(result: subprocess.CompletedProcess, *parts: str, lines: int = 1) -> None:
    """Exit code 2 and one message without a traceback."""
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    assert result.stderr.startswith("stages.")
    assert len(result.stderr.strip().splitlines()) == lines
    for part in parts:
        assert part in result.stderr, result.stderr
