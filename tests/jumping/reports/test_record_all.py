from dataclasses import replace

import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.jumping.reports.record_all import View, as_judged, record_all
from leapgap.logs.log import write_log
from leapgap.logs.metadata import Segment
from leapgap.reports.log_recording import DIAGNOSED
from leapgap.runtime.atomic_io import write_json
from tests.jumping.reports.test_prediction import write_predictions
from tests.reports.read_back import Recorded


@pytest.fixture
def folders(tmp_path):
    names = (
        "references", "simulated", "damped", "published", "replays_damped", "replays_published",
        "predictions_simulated", "predictions_published", "landings",
    )  # fmt: skip
    places = {name: str(tmp_path / name) for name in names}
    return View(**places, most=1, most_predictions=1, most_landings=1, models=[], landing_methods=["ours", "joint_pd"])


def test_every_kind_is_written_with_its_ghosts(tmp_path, robot, hop, ghost, folders):
    for name in ("hop", "hop_2"):
        write_log(replace(hop, name=name), tmp_path / "published" / f"{name}.parquet")
    write_log(ghost, tmp_path / "replays_published" / "nominal" / "hop.parquet")
    (tmp_path / "predictions_published").mkdir()
    write_predictions(tmp_path / "predictions_published" / "hop.parquet", ["nominal"])
    lines = list(record_all(folders, robot, tmp_path / "out"))
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"published_hop.rrd", "prediction_published_hop.rrd"}
    assert "/world/nominal_simulation/trunk" in Recorded(tmp_path / "out" / "published_hop.rrd").moving
    assert f"published: 1 from {tmp_path / 'published'}, 1 more not shown" in lines
    assert f"reference: nothing in {tmp_path / 'references'}, skipped" in lines


def test_a_jump_with_a_clock_of_its_own_is_shown_by_it(tmp_path, robot, hop, ghost, folders):
    write_log(hop, tmp_path / "published" / "hop.parquet")
    write_log(ghost, tmp_path / "replays_published" / "nominal" / "hop.parquet")
    slow = dict(hop.columns) | {"time": 1.5 * hop["time"]}
    info = replace(hop.info, sample_period_s=1.5 * hop.info.sample_period_s)
    write_log(replace(hop, columns=slow, info=info), tmp_path / "replays_published" / "judged" / "hop.parquet")
    assert as_judged(tmp_path / "published" / "hop.parquet", None).time[-1] == hop.time[-1]
    shown = as_judged(tmp_path / "published" / "hop.parquet", str(tmp_path / "replays_published"))
    assert shown.time[-1] == 1.5 * hop.time[-1]
    list(record_all(folders, robot, tmp_path / "out"))
    assert (tmp_path / "out" / "published_hop.rrd").is_file()


def test_predictions_without_their_jump_are_refused(tmp_path, robot, folders):
    (tmp_path / "predictions_published").mkdir()
    write_predictions(tmp_path / "predictions_published" / "gone.parquet", ["nominal"])
    with pytest.raises(InputError, match=r"no jump log .*published/gone\.parquet"):
        list(record_all(folders, robot, tmp_path / "out"))


def test_diagnosis_is_shown_with_its_sentence(tmp_path, robot, hop, ghost, folders):
    write_log(hop, tmp_path / "published" / "hop.parquet")
    write_log(ghost, tmp_path / "replays_published" / "nominal" / "hop.parquet")
    write_json(tmp_path / "replays_published" / DIAGNOSED, {"log": "hop", "sentence": "The loop is slow."})
    list(record_all(folders, robot, tmp_path / "out"))
    shown = Recorded(tmp_path / "out" / "diagnosis_published.rrd")
    assert "/world/nominal_simulation/trunk" in shown.moving
    assert "The loop is slow." in str(shown.static["/notes"])


def test_methods_jump_in_one_scene_with_their_substitutes(tmp_path, robot, hop, ghost, folders):
    landing = {"error_cm": 1.5, "success": True}
    for method, log, substituted in (("ours", hop, []), ("joint_pd", ghost, [[0.1, "late"]]), ("other", ghost, [])):
        write_log(replace(log, name="jump_60_0"), tmp_path / "landings" / method / "jump_60_0.parquet")
        kept = {"landings": [landing], "fallbacks": {"late": len(substituted)}, "substituted": substituted}
        write_json(tmp_path / "landings" / method / "jump_60_0.json", kept)
    lines = list(record_all(folders, robot, tmp_path / "out"))
    found = Recorded(tmp_path / "out" / "landing_jump_60.rrd")
    assert {"/world/ours/trunk", "/world/joint_pd/trunk"} <= set(found.moving)
    assert "/world/other/trunk" not in found.moving
    assert "/phases/joint_pd" in found.moving
    assert "/phases/ours" not in found.moving
    assert f"landing: 1 from {tmp_path / 'landings'}" in lines


def test_methods_are_shown_from_where_their_jumps_begin(tmp_path, robot, hop, ghost, folders):
    """One stands for 0.1 s before it jumps, and says so in its log; the other begins to jump at once."""
    stands = replace(hop.info, stated_segments=(Segment("stand", 0.0, 0.1), Segment("double_contact", 0.1, 9.0)))
    kept = {"landings": [], "fallbacks": {"late": 1}, "substituted": [[0.25, "late"]]}
    for method, log in (("ours", replace(hop, info=stands)), ("joint_pd", ghost)):
        write_log(replace(log, name="jump_60_0"), tmp_path / "landings" / method / "jump_60_0.parquet")
        write_json(tmp_path / "landings" / method / "jump_60_0.json", kept)
    list(record_all(folders, robot, tmp_path / "out"))
    moving = Recorded(tmp_path / "out" / "landing_jump_60.rrd").moving
    times_s, places = moving["/world/ours/trunk"]["Transform3D:translation"]
    rows = np.searchsorted(hop.time, times_s + 0.1 - 1e-6)
    assert np.array(places)[:, 0, 2] == pytest.approx(hop["base_pos_z"][rows], abs=1e-6)
    assert np.ptp(hop["base_pos_z"][rows]) > 0.05
    assert moving["/phases/planned"]["StateChange:state"][1][0] == ["double contact"]
    late_s = [moving[f"/phases/{name}"]["StateChange:state"][0][1] for name in ("ours", "joint_pd")]
    assert late_s == pytest.approx([0.15, 0.25])
