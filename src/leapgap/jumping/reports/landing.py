"""Landing experiment as one HTML page: errors, forces, joints, pitch and fallbacks of each method."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots
from pyarrow import csv

from leapgap.jumping.experiments.landing_experiment import FIGURES, RUNS, TABLE
from leapgap.jumping.task import begin_of
from leapgap.logs.log import Log, read_log
from leapgap.logs.state import commanded_torque
from leapgap.reports.page import render_page
from leapgap.robot.topology import PAIRS
from leapgap.runtime.atomic_io import read_json

METHODS = {
    "learned_goal_mpc": ("learned goal-shift MPC", "#0e8f9e"),
    "ours_adapted": ("ours, adapted to the target", "#0b5d33"),
    "ours": ("ours", "#1f9d57"),
    "joint_pd_shifted": ("joint PD, best constant shift", "#d19a1b"),
    "joint_pd": ("joint PD", "#8a93a3"),
    "joint_pd_corrected": ("joint PD, plans for the corrected robot", "#4b5565"),
    "joint_pd_published": ("joint PD, published plans", "#c3c8d2"),
    "learned_variable": ("learned MPC 25/100, K 10", "#2563c9"),
    "learned_variable_networks": ("learned MPC 25/100, networks", "#3f7fe0"),
    "learned_variable_paper_release": ("learned MPC as released, 25/100", "#0b2a66"),
    "learned_variable_paper_release_corrected": ("the same, plans for the corrected robot", "#123a80"),
    "learned_25_80": ("learned MPC 25/80, K 10", "#5b8fe0"),
    "learned_50_50": ("learned MPC 50/50, K 10", "#8ab2ee"),
    "learned_fixed": ("learned MPC 25/25, K 10", "#b3cdf3"),
    "learned_fixed_k22": ("learned MPC 25/25, K 22", "#7c3aed"),
    "plan_variable": ("learned MPC without its model, 25/100", "#b8860b"),
    "plan_fixed": ("learned MPC without its model, 25/25", "#e0bf6a"),
    "nominal_variable": ("nominal MPC 25/100, K 10", "#e2542f"),
    "nominal_variable_corrected": ("nominal MPC, plans for the corrected robot", "#8f2412"),
    "nominal_fixed": ("nominal MPC 25/25, K 10", "#f0a48e"),
    "nominal_fixed_k22": ("nominal MPC 25/25, K 22", "#a3476b"),
}
"""Label and colour of each method, in the order of the page."""
TASKS = {
    "jump_40": "40 cm",
    "jump_50": "50 cm",
    "jump_60": "60 cm",
    "jump_70": "70 cm",
    "box_60_20": "box, 60 cm ahead, 20 cm up",
    "continuous_60": "4 jumps of 60 cm in a row",
    "block_60": "60 cm, front feet on an unknown 5 cm block",
    "uneven_60": "3 jumps of 60 cm over unknown 2 to 4 cm blocks",
    "push_60": "60 cm, a kick or a push on the way",
    "late_block_60": "60 cm, all feet on blocks that cannot be measured before the jump",
    "crouch_60": "60 cm, from a wrong crouch",
}
STEPS = {
    "learned_fixed": "25 / 25",
    "learned_50_50": "50 / 50",
    "learned_25_80": "25 / 80",
    "learned_variable": "25 / 100",
}
BOX = "box_60_20"
FRICTION, FRICTION_OF_GROUND, LARGEST_N = 0.6, 0.8, 350.0
"""Friction cone of the MPC, friction of the simulated ground, and force limit of the MPC, N."""
LARGEST_PITCH_DEG = 15.0
LEAST_PUSH_N = 20.0
LEAST_SHOWN_CM = 0.05  # Smaller errors are drawn at this value, because the axis is logarithmic
CURVE_STEP_S = 0.005  # Each point of a curve is a mean over this time
SINCE_BEGIN = "s since the first jump began"  # Title of the time axis of curves
Rows = Sequence[Mapping[str, Any]]


def html(figures: Mapping[str, Any], rows: Rows, single: Sequence[str], runs: Path) -> str:
    """The page from the figures (landing.json), one row for each jump (landings.csv), and the folder of cached runs."""
    methods = in_order({row["method"] for row in rows}, METHODS)
    pairs = {(row["hardware"], row["method"]) for row in rows}
    methods_on = {
        hardware: [name for name in methods if (hardware, name) in pairs]
        for hardware in dict.fromkeys(row["hardware"] for row in rows)
    }
    # The hardware with most methods comes first.
    robots = sorted(methods_on, key=lambda hardware: -len(methods_on[hardware]))
    tasks = in_order({row["task"] for row in rows}, TASKS)
    drawn: dict[str, go.Figure] = {}
    for hardware in robots:
        mine, own = [row for row in rows if row["hardware"] == hardware], methods_on[hardware]
        drawn |= {
            f"size_{hardware}": sizes(figures, hardware, own, tasks),
            f"signed_{hardware}": every_jump(mine, own, tasks, *SIGNED),
            f"pitch_{hardware}": every_jump(mine, own, tasks, *PITCHES),
        }
    if rows:
        drawn["bounds"] = bounds(rows, methods)
    first = next((row for row in rows if row["hardware"] == robots[0]), None)
    logs: dict[tuple[str, str], Log] = {}
    for task, method in itertools.product(tasks, methods):
        path = runs / (first["robot"] if first else "") / method / f"{task}_0.parquet"
        if first and path.is_file():
            logs[task, method] = read_log(path)
    if logs:
        drawn |= {"forces": forces(logs), "joints": joints(logs)}
    return render_page(
        Path(__file__).with_name("landing.html"),
        drawn,
        says=sentence(figures["mean_abs_error_cm"], robots, [task for task in single if task in tasks]),
        metrics=figures,
        robots=robots,
        methods=methods,
        methods_on=methods_on,
        tasks=tasks,
        names={name: label(name) for name in methods},
        task_names={name: TASKS.get(name, name) for name in tasks},
        single=single,
        logs_of=first and first["robot"],
        steps={name: steps for name, steps in STEPS.items() if name in methods},
        steps_on=[hardware for hardware in robots if set(STEPS) & set(methods_on[hardware])],
        box=BOX,
        reasons=reasons(runs),
        jumps=len(rows),
    )


@dataclass(frozen=True)
class LandPageSettings:
    """Section ``land_page`` of the configuration."""

    landings: str
    single: list[str]
    out: str | None


def html_of(folder: Path, single: Sequence[str]) -> str:
    """The page of the results that stage ``land`` left in a folder."""
    rows = csv.read_csv(folder / TABLE).to_pylist()
    return html(read_json(folder / FIGURES), rows, single, folder / RUNS)


def label(method: str) -> str:
    """Label of a method on the page."""
    return METHODS.get(method, (method.replace("_", " "), ""))[0]


def colour(method: str) -> str:
    """Colour of a method's points and lines."""
    return METHODS.get(method, ("", "#555555"))[1]


def in_order(there: set[str], known: Mapping[str, Any]) -> list[str]:
    """The names in ``there``: known ones in the order of ``known``, then the others by name."""
    return [name for name in known if name in there] + sorted(there - set(known))


def sentence(means: Mapping[str, float], robots: Sequence[str], single: Sequence[str]) -> str:
    """Main result in one sentence."""
    targets = f"{len(single)} single target{'s' * (len(single) != 1)}"
    for hardware in robots:
        found = {name: means.get(f"{hardware}/{name}") for name in ("ours", "ours_adapted", "nominal_variable")}
        if found["ours"] is None:
            continue
        text = f"Ours lands {found['ours']:.1f} cm from {targets} on {hardware} hardware"
        if found["ours_adapted"] is not None:
            text += f", {found['ours_adapted']:.1f} cm once adapted to each"
        if found["nominal_variable"] is not None:
            text += f"; the nominal MPC {found['nominal_variable']:.1f} cm"
        return text
    return "Where each method lands"


def sizes(figures: Mapping[str, Any], hardware: str, methods: Sequence[str], tasks: Sequence[str]) -> go.Figure:
    """Mean |error| with its interval, one panel for each task, on a shared logarithmic axis."""
    figure = panels(tasks)
    for panel, task in enumerate(tasks):
        for method in reversed(methods):
            key = f"{hardware}/{method}/{task}"
            mean = figures["abs_error_cm"].get(key)
            if mean is None:
                continue
            low, high = figures["abs_error_ci95_cm"][key] or (mean, mean)
            bars = {"array": [high - mean], "arrayminus": [mean - low], "thickness": 1.5, "width": 3}
            marker = {"color": colour(method), "size": 10}
            points = go.Scatter(
                x=[mean], y=[label(method)], error_x=bars, marker=marker, mode="markers", showlegend=False
            )
            figure.add_trace(points, row=panel // 4 + 1, col=panel % 4 + 1)
    return style_panels(figure, methods, "mean of the errors' size, cm; bars: 95 % interval", log=True)


SIGNED = ("error_cm", "error of each jump, cm; positive: short of the target", (0.0,), {"color": "#111827", "width": 1})
PITCHES = (
    *("pitch_deg", "pitch at the landing, degrees, nose-down", (-LARGEST_PITCH_DEG, LARGEST_PITCH_DEG)),
    {"color": "#e2542f", "width": 1, "dash": "dot"},
)
"""Column of the rows, title of the axis, and vertical lines with their style."""


def every_jump(
    rows: Rows,
    methods: Sequence[str],
    tasks: Sequence[str],
    column: str,
    axis: str,
    edges: Sequence[float],
    line: Mapping[str, Any],
) -> go.Figure:
    """One value of every jump as a point, by method, one panel for each task, with vertical lines at some values."""
    figure = panels(tasks)
    for panel, task in enumerate(tasks):
        where = {"row": panel // 4 + 1, "col": panel % 4 + 1}
        for method in reversed(methods):
            values = [row[column] for row in rows if row["task"] == task and row["method"] == method]
            marker, names = {"color": colour(method), "size": 8, "opacity": 0.75}, [label(method)] * len(values)
            figure.add_trace(go.Scatter(x=values, y=names, marker=marker, mode="markers", showlegend=False), **where)
    for panel, edge in itertools.product(range(len(tasks)), edges):
        figure.add_vline(edge, row=panel // 4 + 1, col=panel % 4 + 1, line=line)
    return style_panels(figure, methods, axis)


def bounds(rows: Rows, methods: Sequence[str]) -> go.Figure:
    """|Error| of each jump over the share of commands that its motors could not deliver."""
    figure = go.Figure()
    for method in methods:
        mine = [row for row in rows if row["method"] == method]
        figure.add_trace(
            go.Scatter(
                x=[100 * row["short_of_torque"] for row in mine],
                y=[max(abs(row["error_cm"]), LEAST_SHOWN_CM) for row in mine],
                text=[f"{row['robot']}, {TASKS.get(row['task'], row['task'])}" for row in mine],
                name=label(method),
                marker={"color": colour(method), "size": 7, "opacity": 0.75},
                mode="markers",
            )
        )
    figure.update_layout(height=430, margin={"l": 55, "r": 15, "t": 20, "b": 45})
    figure.update_xaxes(title_text="commands beyond what the motors can deliver, % of joint-milliseconds")
    figure.update_yaxes(title_text="size of the error, cm", type="log", tickvals=[0.1, 0.3, 1, 3, 10, 30])
    return figure


def panels(tasks: Sequence[str]) -> go.Figure:
    """An empty figure: one panel for each task, four in a row, methods on the shared vertical axis."""
    rows = -(-len(tasks) // 4)
    titles = [wrap_title(TASKS.get(task, task)) for task in tasks]
    return make_subplots(
        rows=rows, cols=4, subplot_titles=titles, shared_yaxes=True, horizontal_spacing=0.015, vertical_spacing=0.16
    )


def wrap_title(text: str, width: int = 26) -> str:
    """A title broken into lines of at most ``width`` characters, where words allow."""
    lines = [""]
    for word in text.split():
        lines = [*lines, word] if len(lines[-1]) + len(word) > width else [*lines[:-1], f"{lines[-1]} {word}".strip()]
    return "<br>".join(lines)


def style_panels(figure: go.Figure, methods: Sequence[str], axis: str, log: bool = False) -> go.Figure:
    """Set axes, size and margins of a figure with panels."""
    rows = len(figure._grid_ref)
    names = [label(method) for method in reversed(methods)]
    figure.update_layout(height=90 + rows * (90 + 24 * len(methods)), margin={"l": 10, "r": 10, "t": 60, "b": 70})
    figure.update_yaxes(categoryorder="array", categoryarray=names, range=[-0.7, len(names) - 0.3])
    if log:
        figure.update_xaxes(type="log", range=[-1.3, 1.9], tickvals=[0.1, 0.3, 1, 3, 10, 30])
    figure.update_annotations(font_size=13)
    figure.add_annotation(text=axis, x=0.5, y=0, yshift=-58, xref="paper", yref="paper", showarrow=False)
    return figure


def forces(logs: Mapping[tuple[str, str], Log]) -> go.Figure:
    """Vertical force and force ratio of both pairs, planned and true, with a menu of tasks and methods."""
    titles = [f"{pair} pair: {what}" for what in ("vertical force, N", "|F_x| / F_z") for pair in PAIRS]
    figure = make_subplots(rows=2, cols=2, subplot_titles=titles, horizontal_spacing=0.06, vertical_spacing=0.13)
    owners: list[int] = []
    sources = {"ground_force": ("true ground force", "#2563c9"), "mpc_force": ("planned by the method", "#e2542f")}
    for number, log in enumerate(logs.values()):
        for source, (name, shade) in sources.items():
            force = mean_over_steps(log.pair_force(source), log)
            for pair in range(2):
                along, up = force[:, 2 * pair], force[:, 2 * pair + 1]
                ratio = np.where(up > LEAST_PUSH_N, np.abs(along) / np.maximum(up, LEAST_PUSH_N), np.nan)
                for row, values, digits in ((1, up, 1), (2, ratio, 3)):
                    curve = go.Scatter(
                        x=times(log, len(values)),
                        y=np.round(values, digits),
                        name=name,
                        legendgroup=source,
                        showlegend=row == 1 and pair == 0,
                        line={"color": shade, "width": 1.5},
                        visible=number == 0,
                    )
                    figure.add_trace(curve, row=row, col=pair + 1)
                    owners.append(number)
    for pair in (1, 2):
        for row, edge, text in (
            (1, LARGEST_N, "limit of the MPC"),
            (2, FRICTION, "cone of the MPC"),
            (2, FRICTION_OF_GROUND, "friction of the ground"),
        ):
            line = {"color": "#111827", "width": 1, "dash": "dot"}
            figure.add_hline(edge, row=row, col=pair, line=line, annotation_text=text, annotation_font_size=11)
    figure.update_yaxes(range=[0, 1], row=2)
    figure.update_xaxes(title_text=SINCE_BEGIN, row=2)
    return add_menu(figure, logs, owners, 620)


def joints(logs: Mapping[tuple[str, str], Log]) -> go.Figure:
    """Tracking error of the joints, and their largest torque beside its limit, with a menu of tasks."""
    titles = ["set point − joint angle, rms of all joints, rad", "largest commanded joint torque, N·m"]
    figure = make_subplots(rows=1, cols=2, subplot_titles=titles, horizontal_spacing=0.07)
    owners, tasks = [], list(dict.fromkeys(task for task, _ in logs))
    for (task, method), log in logs.items():
        tracking_error = log.per_joint("cmd_pos") - log.per_joint("joint_pos")
        rms = np.sqrt(mean_over_steps(np.mean(tracking_error**2, axis=1)[:, None], log)[:, 0])
        torque = mean_over_steps(np.abs(commanded_torque(log)).max(axis=1)[:, None], log)[:, 0]
        for col, values, digits in ((1, rms, 4), (2, torque, 1)):
            curve = go.Scatter(
                x=times(log, len(values)),
                y=np.round(values, digits),
                name=label(method),
                legendgroup=method,
                showlegend=col == 1,
                line={"color": colour(method), "width": 1.5},
                visible=task == tasks[0],
            )
            figure.add_trace(curve, row=1, col=col)
            owners.append(tasks.index(task))
    line = {"color": "#111827", "width": 1, "dash": "dot"}
    figure.add_hline(33.5, row=1, col=2, line=line, annotation_text="limit of the motors", annotation_font_size=11)
    figure.update_xaxes(title_text=SINCE_BEGIN)
    return add_menu(figure, tasks, owners, 560)


def add_menu(figure: go.Figure, items: Any, owners: Sequence[int], height: int) -> go.Figure:
    """Add a menu that shows the traces of one item at a time; ``owners`` holds the item of each trace."""
    titles = [(item, "") if isinstance(item, str) else item for item in items]
    labels = [TASKS.get(task, task) + (f": {label(method)}" if method else "") for task, method in titles]
    buttons = [
        {"label": labels[number], "method": "update", "args": [{"visible": [owner == number for owner in owners]}]}
        for number, item in enumerate(items)
    ]
    menu = {"buttons": buttons, "x": 0, "xanchor": "left", "y": 1.0, "yanchor": "bottom", "pad": {"b": 48}}
    figure.update_layout(
        height=height,
        margin={"l": 45, "r": 15, "t": 110, "b": 40},
        updatemenus=[menu],
        legend={"orientation": "h", "y": -0.12, "yanchor": "top"},
    )
    return figure


def mean_over_steps(values: np.ndarray, log: Log) -> np.ndarray:
    """Means of a log's values (rows, n) over ``CURVE_STEP_S`` each, (steps, n)."""
    every = log.info.rows(CURVE_STEP_S)
    whole = len(values) // every
    return values[: whole * every].reshape(whole, every, -1).mean(axis=1)


def times(log: Log, count: int) -> np.ndarray:
    """Times of ``count`` means over ``CURVE_STEP_S`` since the first jump began, s, (count,).

    They are negative while the robot stands before it; methods differ in how long they do.
    """
    since_first_row = (np.arange(count) + 0.5) * log.info.rows(CURVE_STEP_S) * log.info.sample_period_s
    return np.round(since_first_row - begin_of(log), 4)


def reasons(runs: Path) -> list[tuple[str, str, str, int]]:
    """Hardware, method, reason and number of the fallbacks in the cached runs."""
    found: dict[tuple[str, str, str], int] = {}
    for path in sorted(runs.glob("*/*/*.json")):
        robot, method = path.relative_to(runs).parts[:2]
        for reason, count in read_json(path).get("fallbacks", {}).items():
            key = (robot, method, reason)
            found[key] = found.get(key, 0) + count
    return [(*key, count) for key, count in found.items() if count]
