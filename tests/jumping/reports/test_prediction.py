import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from leapgap.errors import InputError
from leapgap.jumping.reports.record_all import record_prediction
from leapgap.reports.plots import COMPONENTS
from tests.reports.read_back import Recorded


def write_predictions(path, models, starts=(0.3, 0.25, 0.2), steps=5):
    """Model ``i`` predicts z = i + start + step; windows and steps are out of order."""
    rows = [
        {"model": model, "window": window, "step": step, "time": start + 0.02 * step}
        | {part.key: 0.0 for part in COMPONENTS}
        | {"z": i + start + step}
        for i, model in enumerate(models)
        for window, start in enumerate(starts)
        for step in reversed(range(steps))
    ]
    pq.write_table(pa.Table.from_pylist(rows), path)


def test_plots_roll_out_nearest_to_the_asked_start(tmp_path, robot, hop):
    write_predictions(tmp_path / "p.parquet", ["measured", "nominal", "networks"])
    record_prediction(tmp_path / "p.rrd", hop, robot, tmp_path / "p.parquet", window_start_s=0.26)
    recorded = Recorded(tmp_path / "p.rrd")
    seconds, values = recorded.moving["/base/z/networks"]["Scalars:scalars"]
    np.testing.assert_allclose(seconds, 0.25 + 0.02 * np.arange(5), atol=1e-9)
    np.testing.assert_allclose(np.ravel(values), 2.25 + np.arange(5), rtol=1e-6)
    np.testing.assert_allclose(
        recorded.at("/base/z/measured", "Scalars:scalars", 0.4), hop["base_pos_z"][400], rtol=1e-6
    )


def test_predicted_ways_follow_the_time_cursor(tmp_path, robot, hop):
    write_predictions(tmp_path / "p.parquet", ["measured", "nominal"])
    record_prediction(tmp_path / "p.rrd", hop, robot, tmp_path / "p.parquet")
    recorded = Recorded(tmp_path / "p.rrd")
    seconds, _ = recorded.moving["/world/predicted/nominal"]["LineStrips3D:strips"]
    np.testing.assert_allclose(seconds, [0.2, 0.25, 0.3])
    way = recorded.at("/world/predicted/nominal", "LineStrips3D:strips", 0.25)
    np.testing.assert_allclose(way[0, :, 2], 1.25 + np.arange(5), rtol=1e-6)
    assert "/world/predicted/measured" not in recorded.moving


def test_truth_alone_is_shown(tmp_path, robot, hop):
    write_predictions(tmp_path / "p.parquet", ["measured"])
    record_prediction(tmp_path / "p.rrd", hop, robot, tmp_path / "p.parquet")
    assert "/base/z/measured" in Recorded(tmp_path / "p.rrd").moving


def test_a_table_without_its_columns_is_refused(tmp_path, robot, hop):
    pq.write_table(pa.table({"model": ["nominal"], "time": [0.1]}), tmp_path / "p.parquet")
    with pytest.raises(InputError, match="found no column window, step, x, z"):
        record_prediction(tmp_path / "p.rrd", hop, robot, tmp_path / "p.parquet")
    assert not (tmp_path / "p.rrd").exists()
