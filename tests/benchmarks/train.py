"""How long does each model take to fit, and what does vectorising the paper's training over windows buy?

The peer is the paper's training as its formulas read: a loop over windows and steps, one small batch each, summed to
one loss. Both move the same first weights for a few steps of Adam on the published windows, or simulated ones;
their losses must agree to single precision. Run as ``python -m tests.benchmarks.train --json <file>``; needs windows
(``dvc repro chunk``). The published script's 0.90 s a step were measured on two cores; here one
thread is enough, and two only pay on cores that nobody else uses.
"""

import argparse
import os
import platform
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from omegaconf import OmegaConf

from leapgap.jumping.learning import store, training
from leapgap.jumping.learning import windows as windows_module
from leapgap.jumping.learning.experiment import Split, TrainConfig, fit_task
from leapgap.jumping.learning.model import Nominal
from leapgap.jumping.learning.models.residual_networks import PublishedRecipeConfig, initial_published_networks
from leapgap.jumping.learning.network import NetworkModel
from leapgap.jumping.learning.store import recipes
from leapgap.jumping.learning.windows import Purpose, Windows
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.runtime.atomic_io import write_json
from stages.compose import compose_conf
from stages.sections.train import read_train_config
from tests.benchmarks import run_benchmark

PUBLISHED_S = 0.90
"""A step of the published script on two server cores, as measured there."""
STEPS = 5
WINDOWS = (Path("data/windows/published"), Path("data/windows/simulated"))


class Looped(training.ResidualModule):
    """The same weights and loss, one window and step at a time."""

    def roll_out(self, batch: training.Batch) -> tuple[torch.Tensor, torch.Tensor]:
        states, penalty = [], torch.zeros(())
        for w in range(len(batch.state)):
            state, path = batch.state[None, w : w + 1, 0], []
            for k, contact in enumerate(batch.in_contact):
                asked = training.Situation(
                    state, batch.foot[w : w + 1, k], batch.time_s[w : w + 1, k], batch.state[None, w : w + 1, 0]
                )
                acceleration, outputs = self(asked, batch.force[w : w + 1, k], w < contact)
                dt = batch.step_s[w, k]
                state = torch.cat([state[..., :3] + dt * state[..., 3:], state[..., 3:] + dt * acceleration], dim=-1)
                penalty = penalty + outputs / len(batch.state)
                path.append(state[0, 0])
            states.append(torch.stack(path))
        return torch.stack(states)[None], penalty / len(batch.in_contact)


def descent(residual: training.ResidualModule, windows: Windows, rate: float, penalty: float) -> Iterator[float]:
    """The loss before each step of Adam, summed as published."""
    batch = training.Batch.of(windows, torch.device("cpu"))
    optimiser = torch.optim.Adam(residual.parameters(), lr=rate)
    while True:
        states, outputs = residual.roll_out(batch)
        loss = ((states - batch.state[:, 1:]) ** 2).sum() + penalty * outputs
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        yield loss.item()


def time_steps(steps: Iterator[float], count: int) -> tuple[list[float], list[float]]:
    """Losses, and seconds of each step."""
    losses, seconds = [], []
    for _ in range(count):
        began = time.perf_counter()
        losses.append(next(steps))
        seconds.append(time.perf_counter() - began)
    return losses, seconds


def published_start(windows: Windows, config: TrainConfig) -> NetworkModel:
    """The paper's networks before training."""
    recipe = config.settings(PublishedRecipeConfig)
    nominal = Nominal(RigidBody(recipe.mass_kg, recipe.pitch_inertia_kgm2))
    return initial_published_networks(windows.grid, nominal, recipe, np.random.default_rng(config.seed))


def fit_seconds(windows: Windows, config: TrainConfig) -> dict[str, float]:
    """Wall seconds of fitting each configured model on all jumps, torch already imported."""
    split, seconds = Split("all", windows.jumps, ()), {}
    with tempfile.TemporaryDirectory() as place:
        for name in config.models:
            task = fit_task(config, split, name, windows, windows.of_jumps([]), Path(place), Path(place) / f".{name}")
            began = time.perf_counter()
            model, _ = recipes()[name].fit(task)
            seconds[name] = time.perf_counter() - began
            store.save(store.StoredModel(model, Purpose.of(windows), windows.jumps, ""), Path(place), name)
    return seconds


def main() -> None:
    """Run the measurement and write its figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--windows", type=Path, help="folder of windows; none: of the published jumps, else simulated")
    parser.add_argument("--threads", type=int, default=1, help="of torch for the recipe; models are fitted with one")
    parser.add_argument("--tiny", action="store_true", help="smallest counts, to see that it runs")
    given = parser.parse_args()
    made = [folder for folder in WINDOWS if (folder / "windows.json").is_file() and len(windows_module.read(folder))]
    windows = windows_module.read(given.windows or (made or WINDOWS)[0])
    config = read_train_config(OmegaConf.create(compose_conf()).train)
    steps = STEPS
    if given.tiny:
        windows = windows.of_jumps(windows.jumps[:2])
        config, steps = replace(config, models=["nominal_fitted", "constant_velocity"]), 1
    config.trainer["enable_progress_bar"] = False
    torch.set_num_threads(given.threads)
    start, fitting = published_start(windows, config), config.settings(PublishedRecipeConfig).fitting
    recipe = (windows, fitting.learning_rate, fitting.output_penalty)
    vectorised, peer = training.ResidualModule(start, 0.0), Looped(start, 0.0)
    ours, ours_s = time_steps(descent(vectorised, *recipe), steps)
    looped, looped_s = time_steps(descent(peer, *recipe), steps)
    apart = max(abs(a - b) / b for a, b in zip(ours, looped, strict=True))
    weights = zip(vectorised.parameters(), peer.parameters(), strict=True)
    weights_apart = max(float((a - b).detach().abs().max()) for a, b in weights)
    result = {
        "fit_seconds": fit_seconds(windows, config),
        "published_recipe_seconds_per_step": float(np.median(ours_s)),
        "published_recipe_seconds_per_step_best": min(ours_s),
        "looped_seconds_per_step": float(np.median(looped_s)),
        "ratio_to_looped": float(np.median(looped_s) / np.median(ours_s)),
        "ratio_to_published_script": PUBLISHED_S / float(np.median(ours_s)),
        "losses": ours,
        "looped_losses": looped,
        "losses_apart_relative": apart,
        "weights_apart": weights_apart,
        "windows": len(windows),
        "threads": given.threads,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, torch {torch.__version__}",
    }
    write_json(given.json, result)
    for name, value in result.items():
        print(f"{name}: {value}")


if __name__ == "__main__":
    run_benchmark(main)
