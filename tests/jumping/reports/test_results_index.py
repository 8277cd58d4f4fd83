"""The index of all results: what metrics say stands on it, what is absent is said, and every command exists."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from leapgap.errors import InputError
from leapgap.jumping.reports.results_index import SOURCES, bar_chart, html, markdown, sections
from stages.repro import stage_names
from tests.code import ROOT
from tests.project import environment
from tests.reports.browser import DESKTOP, PHONE, Browser, needs_chromium

DIAGNOSIS = {
    "verdict": "named",
    "answer": "payload",
    "closure_heldout": 0.876,
    "gap_nominal": 1.5,
    "gap_corrected": 0.2,
}


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A project with one diagnosis, its page, and nothing else."""
    (tmp_path / "metrics/damped").mkdir(parents=True)
    (tmp_path / "metrics/damped/diagnosis.json").write_text(json.dumps(DIAGNOSIS | {"noise_floor": None}))
    report = tmp_path / "data/reports/damped"
    report.mkdir(parents=True)
    (report / "report.json").write_text(json.dumps({"sentence": "a payload <b>explains</b> all of it."}))
    (report / "report.html").write_text("page")
    return tmp_path


def test_figures_sentence_and_page_of_what_is_there(project: Path) -> None:
    page = html(sections(project))
    part = page[page.index(">Diagnosis of damped joints</h2>") : page.index(">Injected effects</h2>")]
    assert re.search(r"<td>gap closed on logs not fitted on</td><td>88 %</td><td><code>dvc repro report@damped", part)
    assert "<td>noise floor</td><td>–</td>" in part
    assert "A payload &lt;b&gt;explains&lt;/b&gt; all of it." in part
    assert 'href="reports/damped/report.html"' in part


@pytest.mark.parametrize("content", ["{}", '{"mean_abs_error_cm": 3}', '{"mean_abs_error_cm": {"a": null, "b": "x"}}'])
def test_metrics_of_another_form_are_refused_with_the_command_that_makes_them(project: Path, content: str) -> None:
    (project / "metrics/landing.json").write_text(content)
    with pytest.raises(InputError, match=r"landing\.json: found other figures .* make it again: dvc repro land$"):
        sections(project)


def test_what_is_absent_is_a_stated_result_with_its_command(project: Path) -> None:
    page, text = html(sections(project)), markdown(sections(project))
    for source in SOURCES:
        if source.title != "Diagnosis of damped joints":
            assert f"Not there: <code>{source.command}</code> makes it." in page
            assert f"Not there: `{source.command}` makes it." in text
    assert page.count("Not there") == len(SOURCES) - 1
    assert 'href="reports/real/report.html"' not in page


def test_every_command_exists_and_every_committed_figure_can_be_read() -> None:
    stages = [name for path in ("dvc.yaml", "published/dvc.yaml") for name in stage_names(Path(path))]
    makefile = (ROOT / "Makefile").read_text()
    for source in SOURCES:
        words = source.command.split()
        if words[:2] == ["dvc", "repro"]:
            assert words[2] in stages
        elif words[0] == "make":
            assert re.search(rf"^{words[1]}:", makefile, re.MULTILINE)
        else:
            assert (ROOT / f"{words[2].replace('.', '/')}.py").is_file()
    for part in sections(ROOT):
        there = (ROOT / "metrics" / part.source.metrics).is_file()
        assert part.absent is not there
        assert part.absent or part.figures


def test_the_longest_bar_is_that_of_the_largest_value() -> None:
    chart = bar_chart({"small": 1.0, "large": 4.0, "a < b": 2.0}, "cm")
    widths = [float(width) for width in re.findall(r'<rect[^>]* width="([\d.]+)"', chart)]
    assert widths[1] == 4 * widths[0] == 2 * widths[2]
    assert "a &lt; b" in chart


def test_a_page_of_somebody_else_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text("<title>my thesis</title>")
    command = [
        sys.executable,
        "-m",
        "stages.index",
        f"index.out={tmp_path / 'index.html'}",
        f"hydra.run.dir={tmp_path / 'run'}",
    ]
    done = subprocess.run(command, cwd=ROOT, env=environment(ROOT), capture_output=True, text=True)
    assert done.returncode == 2
    assert "found a file that this stage did not write" in done.stderr
    assert (tmp_path / "index.html").read_text() == "<title>my thesis</title>"
    (tmp_path / "index.html").unlink()
    for _ in range(2):  # its own page is replaced
        done = subprocess.run(command, cwd=ROOT, env=environment(ROOT), capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    assert "All results" in (tmp_path / "index.html").read_text()


@needs_chromium
@pytest.mark.parametrize("size", [PHONE, DESKTOP])
def test_the_index_fits_its_window(tmp_path: Path, size: tuple[int, int]) -> None:
    (tmp_path / "index.html").write_text(html(sections(ROOT)), encoding="utf-8")
    script = """{ wide: document.documentElement.scrollWidth, window: window.innerWidth,
      bars: document.querySelectorAll("svg rect").length }"""
    found = Browser(size, dark=True).evaluate(tmp_path / "index.html", script, tmp_path)
    assert found["wide"] <= found["window"]
    assert found["bars"] > 20
