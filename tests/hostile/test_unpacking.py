"""Files that unpack to more than they may are refused while they unpack, whatever they state of it."""

import bz2
import sqlite3
from pathlib import Path

import lz4.frame
import pytest
from rosbags.rosbag1 import reader as bags
from rosbags.rosbag2 import reader as recordings
from rosbags.rosbag2 import storage_mcap

from leapgap.errors import InputError
from leapgap.logs.importers.csv import Csv, CsvOptions
from leapgap.logs.importers.ros import bounded_unpacking, check_tables
from tests.hostile.logs import Case, run_cases
from tests.hostile.packed_bombs import BOMBS, csv_gz


@pytest.mark.long
def test_bombs_are_set_aside_and_take_no_memory() -> None:
    cases = [Case(0, layout, "special", name) for name, (layout, _) in BOMBS.items()]
    results = {one.case.name: one for one in run_cases(cases, 1)}
    assert {one.outcome for one in results.values()} == {"set_aside"}, results
    for name in ("mat_small_head", "hdf5_piece", "npz_header"):
        assert "bytes when unpacked" in results[name].says, results[name]
    assert "as the file states" in results["parquet_pages"].says, results["parquet_pages"]


@pytest.mark.long
def test_a_packed_text_is_read_and_one_without_end_is_not(tmp_path: Path) -> None:
    import gzip

    small, bomb = tmp_path / "small.csv.gz", tmp_path / "bomb.csv.gz"
    small.write_bytes(gzip.compress(b"time,a\n0,1\n0.1,2\n"))
    assert Csv().read_table(small, CsvOptions(), lambda _: True)["a"].tolist() == [1, 2]
    assert list(Csv().find(tmp_path)) == ["small"]
    csv_gz(bomb)
    with pytest.raises(InputError, match="more than 1000000000 bytes when unpacked"):
        Csv().read_table(bomb, CsvOptions(), lambda _: True)


def test_pieces_of_recordings_unpack_within_limits(tmp_path: Path) -> None:
    """The reader of recordings has its unpackers back afterwards."""
    path = tmp_path / "one.mcap"
    path.write_bytes(b"x")
    before = recordings.zstd
    large = bytes(300 << 20)
    packed = {"lz4": lz4.frame.compress(large), "zstd": before.compress(large), "bz2": bz2.compress(large[: 300 << 18])}
    with bounded_unpacking(path):
        for name in ("lz4", "zstd"):
            with pytest.raises(InputError, match="268435456 at most"):
                storage_mcap.decompress(packed[name], name, len(large), 0)
        with pytest.raises(InputError, match="268435456 at most"):
            bags.decompressors["lz4"](packed["lz4"])
        with pytest.raises(InputError, match="268435456 at most"):
            recordings.zstd.decompress(packed["zstd"])
        assert storage_mcap.decompress(before.compress(b"abc"), "zstd", 3, 0) == b"abc"
        assert len(bags.decompressors["bz2"](packed["bz2"])) == 300 << 18
        assert recordings.zstd is not before
    assert recordings.zstd is before
    assert len(storage_mcap.decompress(packed["zstd"], "zstd", len(large), 0)) == len(large)


COMPUTED = {
    "a view without end": "CREATE VIEW messages AS "
    "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i FROM n) SELECT * FROM n",
    "a column of gigabytes": "CREATE TABLE messages (id INTEGER, data BLOB GENERATED ALWAYS AS (zeroblob(1000000000)))",
    "a trigger": "CREATE TABLE a (b); CREATE TRIGGER t AFTER INSERT ON a BEGIN DELETE FROM a; END",
}


@pytest.mark.parametrize("name", COMPUTED)
def test_tables_that_are_computed_are_not_read(name: str, tmp_path: Path) -> None:
    path = tmp_path / "a.db3"
    with sqlite3.connect(path) as base:
        base.executescript(COMPUTED[name])
    base.close()
    with pytest.raises(InputError, match="computed when they are read"):
        check_tables(path)
