"""Pages as a browser shows them: on light and dark, on phone and desktop, with the curves of the logs in them."""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import leapgap as lg
from leapgap import cli
from leapgap.diagnosis.gap import Interval
from leapgap.diagnosis.report import Cause, ParameterEstimate
from leapgap.errors import InputError
from leapgap.reports import viewer as viewer_module
from leapgap.reports.channels_data import channels_data
from leapgap.reports.diagnosis_figures import similarity
from leapgap.reports.viewer import embedded_viewer
from leapgap.robot.model import Robot
from tests import plain_arm
from tests.reports.browser import DESKTOP, PHONE, Browser, needs_chromium

LARGEST_LIGHT = 3_000_000


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an arm's model, its logs and a saved report on few effects."""
    folder = tmp_path_factory.mktemp("arm")
    plain_arm.write_model(folder)
    plain_arm.write_parquet(folder / "logs")
    quick = lg.Settings(effects=["joint_damping", "command_delay"], bootstrap_draws=100, noise_draws=1)
    replace(lg.diagnose(folder / "logs", folder / "arm.xml", quick), record=None).save(folder / "report")
    return folder


@pytest.fixture(scope="module")
def page(arm: Path) -> Path:
    return arm / "report" / "report.html"


def test_the_light_page_is_small_and_loads_nothing(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert len(text.encode()) < LARGEST_LIGHT
    assert not re.search(r'(?:src|href)="(?:https?:)?//', text)


@needs_chromium
@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("size", [PHONE, DESKTOP])
def test_the_page_fits_its_window_and_its_figures_are_drawn(
    page: Path, tmp_path: Path, size: tuple[int, int], dark: bool
) -> None:
    script = """{ wide: document.documentElement.scrollWidth, window: window.innerWidth,
      empty: [...document.querySelectorAll(".figure")].filter((one) => !one.querySelector(".main-svg"))
        .map((one) => one.id),
      columns: new Set(Object.values(document.getElementById("figure-channels")._fullLayout._plots)
        .map((one) => one.xaxis._offset)).size,
      ink: getComputedStyle(document.querySelector("h1")).color,
      nominal: document.getElementById("figure-channels").data[0].line.color,
      tiles: [...document.querySelectorAll(".tile")].map((one) => Math.round(one.getBoundingClientRect().top)) }"""
    found = Browser(size, dark).evaluate(page, script, tmp_path)
    assert found["empty"] == []
    assert found["wide"] <= found["window"], "the page is wider than its window"
    assert found["columns"] == (1 if size == PHONE else 2)  # four channels, two by two
    assert found["ink"] == ("rgb(230, 233, 239)" if dark else "rgb(17, 24, 39)")
    assert found["nominal"] == ("#f27a58" if dark else "#e2542f")
    tops = found["tiles"]
    assert len(tops) == 4 and (len(set(tops)) == 1 if size == DESKTOP else tops[0] == tops[1] < tops[2] == tops[3])
    picture = Browser(size, dark).picture(page, tmp_path)
    ground = np.median(picture.reshape(-1, 3), axis=0)
    assert (ground < 60).all() if dark else (ground > 240).all()
    orange = (picture[..., 0] > 200) & (picture[..., 1] < 140) & (picture[..., 2] < 110)
    assert orange.sum() > 50, "the nominal gap is not told in its colour"


@needs_chromium
def test_the_chosen_log_and_part_are_drawn_from_their_columns(page: Path, arm: Path, tmp_path: Path) -> None:
    logs = {log.name: log for log in lg.read_logs(arm / "logs")}
    name = sorted(logs)[-1]
    script = f"""(() => {{ const [log, group, view] = ["log", "group", "view"]
        .map((one) => document.getElementById(`choose-${{one}}`));
      const figure = document.getElementById("figure-channels");
      const residual = [...figure.data[0].y], title = figure.layout.annotations[0].text;
      const band = figure.layout.shapes.find((one) => one.type === "rect");
      log.value = {json.dumps(name)}; group.value = "upper"; view.value = "motions";
      log.dispatchEvent(new Event("change"));
      return {{ residual, title, band: [band.y0, band.y1], parts: [...group.options].map((one) => one.value),
        titles: figure.layout.annotations.map((one) => one.text),
        x: [...figure.data[0].x], y: [...figure.data[0].y] }}; }})()"""
    found = Browser(DESKTOP).evaluate(page, script, tmp_path)
    log = logs[name]
    assert found["parts"] == ["largest errors", "upper"]  # the arm's one limb, by the body that it begins with
    assert found["band"][1] == -found["band"][0] > 0
    channel = re.match(r"(\w+) (position|velocity), ", found["titles"][0])
    assert channel
    column = log[f"joint_{channel[2][:3]}/{channel[1]}"]
    at = np.interp(found["x"], log.time, column)
    np.testing.assert_allclose(found["y"], at, atol=2e-3 * np.abs(column).max())


@needs_chromium
def test_the_pointer_over_a_curve_marks_its_time_in_all_others(page: Path, tmp_path: Path) -> None:
    script = """(() => { leapgap.seekers.forEach((seek) => seek(0.5));
      const place = document.getElementById("figure-channels"), { xaxis } = Object.values(place._fullLayout._plots)[0];
      return { lines: document.querySelectorAll("[data-over-time] .cursor").length,
        at: parseFloat(place.querySelector(".cursor").style.left), expected: xaxis._offset + xaxis.d2p(0.5) }; })()"""
    found = Browser(DESKTOP).evaluate(page, script, tmp_path)
    assert found["lines"] >= 3
    assert found["at"] == pytest.approx(found["expected"], abs=0.5)


def test_curves_are_thinned_so_that_a_page_stays_small(robot: Robot) -> None:
    from tests.conftest import standing

    logs = [replace(standing(robot, 4000), name=f"log_{i}") for i in range(20)]
    replays = {log.name: log for log in logs}
    report = SimpleNamespace(median_log=logs[0].name, headline=SimpleNamespace(preset=None), where=())
    data = channels_data(report, logs, robot, replays, replays)  # type: ignore[arg-type]
    values = sum(len(curve) for log in data["logs"].values() for of in log["channels"].values() for curve in of)
    assert 50_000 < values < 130_000
    assert set(data["groups"]) == {"base", *map(robot.limb_of, robot.joints)}


def test_effects_that_do_the_same_to_the_logs_are_alike_and_others_are_not(arm: Path) -> None:
    """Viscous and Coulomb friction of one joint both resist it; friction of another joint moves other channels."""

    def cause(effect: str, place: str, **values: float) -> Cause:
        found = {name: ParameterEstimate(value, (value, value), 0.0, "", False) for name, value in values.items()}
        return Cause(effect, place, 0.5, found, {}, Interval(0, 0, 0), 1.0, ())

    causes = [
        cause("joint_damping", "elbow", damping=0.3),
        cause("joint_friction", "elbow", torque_nm=0.3),
        cause("joint_damping", "shoulder", damping=0.3),
        cause("a_class_of_somebodys_own", "all", x=1.0),
    ]
    found = similarity(causes, lg.read_logs(arm / "logs"), Robot.load(arm / "arm.xml"))
    assert found is not None
    assert found.names == ("viscous friction (elbow)", "joint Coulomb friction (elbow)", "viscous friction (shoulder)")
    alike = found.correlation
    np.testing.assert_allclose(np.diag(alike), 1)
    assert alike[0, 1] > 0.7 > 0.5 > abs(alike[0, 2])
    assert similarity(causes[:1], lg.read_logs(arm / "logs"), Robot.load(arm / "arm.xml")) is None


def test_a_viewer_that_is_none_is_refused(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(["diagnose", str(arm / "logs"), str(arm / "arm.xml"), "--viewer", "heavy"])
    assert "invalid choice: 'heavy'" in capsys.readouterr().err


def test_without_the_viewers_package_it_says_what_to_install(
    arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(viewer_module, "find_spec", lambda _: None)
    arguments = [str(arm / "logs"), str(arm / "arm.xml"), "--viewer", "embedded", "--out", str(tmp_path / "out")]
    assert cli.main(["diagnose", *arguments]) == 2
    said = capsys.readouterr().err
    assert "viewer: found embedded without the package rerun-notebook" in said
    assert "pip install --no-deps rerun-notebook==" in said
    assert not (tmp_path / "out").exists()


def test_a_viewer_built_in_another_way_is_refused_and_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "widget.js").write_text("var WebViewer = class {};\nexport { WebViewer };\n")  # no marker
    (tmp_path / "re_viewer_bg.wasm").write_bytes(b"\0asm")
    monkeypatch.setattr(viewer_module, "viewer_folder", lambda: tmp_path)
    with pytest.raises(InputError, match="a viewer that is built in another way"):
        embedded_viewer(b"RRF2")


@needs_chromium
def test_with_the_viewer_inside_plots_and_robot_show_one_time(arm: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    if viewer_module.find_spec("rerun_notebook") is None:
        pytest.skip("no rerun-notebook")
    quick = lg.Settings(effects=["joint_damping"], bootstrap_draws=100, noise_draws=1)
    report = lg.diagnose(arm / "logs", arm / "arm.xml", quick)
    page = report.save(tmp_path / "report", viewer="embedded") / "report.html"
    script = """(async () => { const until = Date.now() + 100000;
      const wait = (ms) => new Promise((go) => setTimeout(go, ms));
      while (!leapgap.recording && Date.now() < until) await wait(200);
      while (Math.abs((leapgap.viewerTime ?? 0) - 0.7) > 0.01 && Date.now() < until) {
        leapgap.seekers.forEach((seek) => seek(0.7)); await wait(500); }
      return { time: leapgap.viewerTime, canvas: document.querySelector("#robot canvas")?.width }; })()"""
    found = Browser(DESKTOP, software_gl=True).evaluate(page, script, tmp_path, seconds=150)
    assert found["time"] == pytest.approx(0.7, abs=0.01)
    assert found["canvas"] > 500
