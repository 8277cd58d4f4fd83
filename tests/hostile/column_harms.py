"""What may be wrong with the columns of a log: small functions that harm them before the file is written."""

from collections.abc import Callable, Mapping

import numpy as np

from tests.hostile.base_logs import Columns

Harm = Callable[[Columns, np.random.Generator], Columns]
DEGREES = 180 / np.pi


def chosen(columns: Columns, rng: np.random.Generator, *starts: str) -> str:
    """One column whose name begins so; any but the time where no name begins so."""
    names = [name for name in columns if name.startswith(starts or ("",)) and name != "time"]
    return str(rng.choice(names or [name for name in columns if name != "time"]))


def with_value(columns: Columns, name: str, row: int, value: float) -> Columns:
    """The columns with another value in one row."""
    values = columns[name].copy()
    values[row] = value
    return columns | {name: values}


def one_value(*values: float) -> Harm:
    """One value of one column is one of these."""

    def harm(columns: Columns, rng: np.random.Generator) -> Columns:
        name = chosen(columns, rng)
        return with_value(columns, name, int(rng.integers(len(columns[name]))), float(rng.choice(values)))

    return harm


def whole_column(change: Callable[[np.ndarray], np.ndarray], *starts: str) -> Harm:
    """One column is changed in all rows."""

    def harm(columns: Columns, rng: np.random.Generator) -> Columns:
        name = chosen(columns, rng, *starts)
        return columns | {name: change(columns[name])}

    return harm


def all_columns(change: Callable[[np.ndarray], np.ndarray], *starts: str) -> Harm:
    """All columns whose names begin so are changed in all rows."""

    def harm(columns: Columns, _: np.random.Generator) -> Columns:
        return {name: change(values) if name.startswith(starts) else values for name, values in columns.items()}

    return harm


def rows_taken(choose: Callable[[int, np.random.Generator], np.ndarray], renumber: bool = False) -> Harm:
    """Some rows in some order; with ``renumber`` the time is as if nothing had happened."""

    def harm(columns: Columns, rng: np.random.Generator) -> Columns:
        rows = choose(len(columns["time"]), rng)
        taken = {name: values[rows] for name, values in columns.items()}
        step = columns["time"][1] - columns["time"][0]
        return taken | ({"time": step * np.arange(len(rows))} if renumber else {})

    return harm


def lost_block(rows: int, rng: np.random.Generator) -> np.ndarray:
    """All rows but a block of an eighth."""
    begin = int(rng.integers(rows // 4, rows // 2))
    return np.delete(np.arange(rows), slice(begin, begin + rows // 8))


def lost_rows(rows: int, rng: np.random.Generator) -> np.ndarray:
    """Nine of ten rows, in order."""
    return np.sort(rng.permutation(rows)[: 9 * rows // 10])


def spike(size: float, *starts: str) -> Harm:
    """One row of one column leaves its course by a multiple of the column's range."""

    def harm(columns: Columns, rng: np.random.Generator) -> Columns:
        name = chosen(columns, rng, *starts)
        row = int(rng.integers(5, len(columns[name]) - 5))
        high = size * max(float(np.ptp(columns[name])), 1.0)
        return with_value(columns, name, row, columns[name][row] + float(rng.choice([-1, 1])) * high)

    return harm


def exchanged(*places: tuple[str, int]) -> Harm:
    """Two columns, each by its quantity and the number of its joint, stand in each other's place."""

    def harm(columns: Columns, _: np.random.Generator) -> Columns:
        first, second = ([c for c in columns if c.startswith(f"{name}/")][number] for name, number in places)
        return columns | {first: columns[second], second: columns[first]}

    return harm


def without(columns: Columns, *starts: str) -> Columns:
    """The columns but those whose names begin so."""
    return {name: values for name, values in columns.items() if not name.startswith(starts)}


def removed(*starts: str) -> Harm:
    """A harm that leaves out the columns whose names begin so."""
    return lambda columns, _: without(columns, *starts)


def quaternion(order: str) -> Harm:
    """The components of the attitude stand in another order; without a base the joints do."""

    def harm(columns: Columns, rng: np.random.Generator) -> Columns:
        if "base_quat_w" not in columns:
            return exchanged(("joint_pos", 0), ("joint_pos", 1))(columns, rng)
        return columns | {f"base_quat_{a}": columns[f"base_quat_{b}"] for a, b in zip("wxyz", order, strict=True)}

    return harm


def stuck(columns: Columns, rng: np.random.Generator) -> Columns:
    """A sensor of position and velocity of a joint repeats its first value."""
    name = chosen(columns, rng, "joint_pos/")
    of = name.removeprefix("joint_pos/")
    return columns | {
        name: np.full_like(columns[name], columns[name][0]),
        f"joint_vel/{of}": np.zeros(len(columns[name])),
    }


def extra(name: str) -> Harm:
    """A column more, of any name."""
    return lambda columns, rng: columns | {name: rng.standard_normal(len(columns["time"]))}


def extra_text(columns: Columns, _: np.random.Generator) -> Columns:
    """A column of texts more."""
    return columns | {"remark": np.array(["so"] * len(columns["time"]), dtype=object)}


def renamed(columns: Columns, _: np.random.Generator) -> Columns:
    """The first joint has a name in another script."""
    name = next(one for one in columns if one.startswith("joint_pos/")).removeprefix("joint_pos/")
    return {key.replace(f"/{name}", "/колено\u202e"): values for key, values in columns.items()}


def as_texts(columns: Columns, rng: np.random.Generator) -> Columns:
    """Numbers of one column are texts."""
    name = chosen(columns, rng, "joint_pos/")
    return columns | {name: np.array([f"{value:.17g}" for value in columns[name]], dtype=object)}


def words(columns: Columns, rng: np.random.Generator) -> Columns:
    """One column has a word in one row."""
    name = chosen(columns, rng, "joint_pos/")
    texts = np.array([f"{value:.9g}" for value in columns[name]], dtype=object)
    texts[int(rng.integers(len(texts)))] = "broken"
    return columns | {name: texts}


def time_of(change: Callable[[np.ndarray], np.ndarray]) -> Harm:
    """The time is another."""
    return lambda columns, _: columns | {"time": change(columns["time"])}


def backwards(time: np.ndarray) -> np.ndarray:
    """Time that runs back."""
    return time[::-1].copy()


def leap_back(time: np.ndarray) -> np.ndarray:
    """Time that leaps back in the middle."""
    return np.where(np.arange(len(time)) > len(time) // 2, time - time[len(time) // 2], time)


HARMS: Mapping[str, Harm] = {
    "nan": one_value(np.nan),
    "inf": one_value(np.inf, -np.inf),
    "huge": one_value(1e9, -1e9, 1e12, 1e38, 1e300, -1e300),
    "nan_column": whole_column(lambda values: np.full_like(values, np.nan)),
    "huge_column": whole_column(lambda values: values * 1e9 + 1e9),
    "negative_gain": all_columns(np.negative, "cmd_kp", "cmd_kd", "joint_vel/"),
    "degrees_positions": all_columns(lambda values: values * DEGREES, "joint_pos/"),
    "degrees_velocities": all_columns(lambda values: values * DEGREES, "joint_vel/"),
    "degrees_set_points": all_columns(lambda values: values * DEGREES, "cmd_pos/"),
    "degrees_one_joint": whole_column(lambda values: values * DEGREES, "joint_pos/"),
    "degrees_all": all_columns(lambda values: values * DEGREES, "joint_pos/", "joint_vel/", "cmd_pos/", "cmd_vel/"),
    "turns": all_columns(lambda values: values / (2 * np.pi), "joint_pos/"),
    "millimetres": all_columns(lambda values: values * 1e3, "base_pos", "joint_pos"),
    "gyro_degrees": all_columns(lambda values: values * DEGREES, "base_angvel", "joint_vel"),
    "torque_units": all_columns(lambda values: values * 1e3, "tau/", "cmd_tau/"),
    "xyzw": quaternion("xyzw"),
    "zyxw": quaternion("zyxw"),
    "quaternion_doubled": all_columns(lambda values: values * 2, "base_quat", "joint_vel"),
    "quaternion_zero": all_columns(np.zeros_like, "base_quat", "joint_vel"),
    "other_sign": all_columns(np.negative, "joint_vel/"),
    "rows_twice": rows_taken(lambda rows, _: np.repeat(np.arange(rows), 2)),
    "rows_twice_renumbered": rows_taken(lambda rows, _: np.repeat(np.arange(rows), 2), renumber=True),
    "rows_lost": rows_taken(lost_block),
    "rows_lost_here_and_there": rows_taken(lost_rows),
    "rows_lost_renumbered": rows_taken(lost_block, renumber=True),
    "every_third_row_renumbered": rows_taken(lambda rows, _: np.arange(0, rows, 3), renumber=True),
    "rows_shuffled": rows_taken(lambda rows, rng: rng.permutation(rows)),
    "rows_shuffled_renumbered": rows_taken(lambda rows, rng: rng.permutation(rows), renumber=True),
    "rows_reversed_renumbered": rows_taken(lambda rows, _: np.arange(rows)[::-1], renumber=True),
    "one_row": rows_taken(lambda rows, _: np.arange(1)),
    "no_row": rows_taken(lambda rows, _: np.arange(0)),
    "milliseconds": time_of(lambda time: time * 1e3),
    "nanoseconds": time_of(lambda time: time * 1e9),
    "kiloseconds": time_of(lambda time: time * 1e-3),
    "time_back": time_of(backwards),
    "time_leaps_back": time_of(leap_back),
    "time_stands": time_of(np.zeros_like),
    "time_nan": time_of(lambda time: np.where(time > 0.5, np.nan, time)),
    "half_speed": time_of(lambda time: time * 2),
    "spike": spike(3.0, "joint_pos/", "joint_vel/", "base_"),
    "small_spike": spike(0.3, "joint_pos/"),
    "spike_sent": spike(3.0, "cmd_"),
    "joints_exchanged": exchanged(("joint_pos", 0), ("joint_pos", 1)),
    "position_is_velocity": exchanged(("joint_pos", 0), ("joint_vel", 0)),
    "stuck": stuck,
    "positions_stand": all_columns(lambda values: np.full_like(values, values[0]), "joint_pos/"),
    "whole_numbers": all_columns(np.round, "joint_pos/"),
    "int8": all_columns(lambda values: values.astype(np.int8), "joint_"),
    "float32": all_columns(lambda values: values.astype(np.float32), "joint_", "cmd_", "base_"),
    "truth_values": all_columns(lambda values: values > 0, "joint_pos/"),
    "other_byte_order": whole_column(lambda values: values.byteswap(), "joint_", "base_"),
    "no_time": removed("time"),
    "no_gains": removed("cmd_kp"),
    "no_commands": removed("cmd_"),
    "no_positions": removed("joint_pos"),
    "no_velocities": removed("joint_vel"),
    "one_joint": removed("joint_pos/hip", "cmd_kp/hip", "joint_pos/FR_hip"),
    "part_of_a_quaternion": removed("base_quat_x", "cmd_vel/knee"),
    "more_columns": extra("temperature"),
    "unicode_column": extra("\u202eтемпература/\N{PILE OF POO}\n"),
    "html_column": extra("<script>alert(1)</script>"),
    "long_name": extra("x" * 5000),
    "text_column": extra_text,
    "unicode_joint": renamed,
    "texts": as_texts,
    "words": words,
    "complex": whole_column(lambda values: values + 1j, "joint_pos/"),
    "dates": whole_column(lambda values: (values * 1e9).astype("M8[ns]"), "joint_pos/"),
}
"""Harms to the columns, before the file is written."""
