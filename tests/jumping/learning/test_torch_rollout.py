"""The torch twin of the networks against NumPy, and the gradients of its roll-outs."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from leapgap.jumping.learning import store, training
from leapgap.jumping.learning.model import Nominal
from leapgap.jumping.learning.models.residual_networks import (
    PublishedRecipeConfig,
    initial_networks,
    initial_published_networks,
)
from leapgap.jumping.learning.windows import Purpose, Windows
from leapgap.jumping.models.rigid_body import RigidBody, Situation
from tests.conftest import A1_BODY
from tests.jumping.learning.test_training import NETWORKS, same


def published_model(windows: Windows):
    return initial_published_networks(
        windows.grid,
        Nominal(RigidBody(12.0, 0.17)),
        PublishedRecipeConfig(hidden_h=[8, 8], hidden_G=[9, 9], orthogonal_gain=1.0),
        np.random.default_rng(3),
    )


def our_model(windows: Windows):
    nominal = Nominal(A1_BODY, (0.5, 0.9, 0.3))
    return initial_networks(windows, nominal, replace(NETWORKS, output_gain=1.0), np.random.default_rng(3))


@pytest.mark.parametrize("make", [our_model, published_model])
def test_the_numpy_reader_equals_the_network(make, windows: Windows, tmp_path):
    model = make(windows)
    twin = training.ResidualModule(model, dropout=0.5).eval()
    store.save(store.StoredModel(model, Purpose.of(windows), windows.jumps, "k"), tmp_path, "m")
    read = store.load(tmp_path, "m").model
    assert isinstance(read, type(model)) and same(read, model)
    state = windows.state[:, 1] * 1.01
    situation = Situation(state, windows.foot[:, 1], windows.time_s[:, 1], windows.state[:, 0])
    force = windows.force[:, 1]
    for pushing in (True, False):
        terms = read.members(situation, pushing)
        ours = terms.bias + np.einsum("snij,nj->sni", terms.by_force, force)
        ours = ours + read.nominal.at(situation.foot).acceleration(force)

        now, foot, time_s, start = (torch.tensor(a, dtype=torch.float32) for a in vars(situation).values())
        asked = Situation(now.expand(len(ours), -1, -1), foot, time_s, start.expand(len(ours), -1, -1))
        theirs = twin(asked, torch.tensor(force, dtype=torch.float32), pushing)[0].detach().numpy()
        np.testing.assert_allclose(theirs, ours, rtol=1e-5, atol=1e-5 * np.abs(ours).max())


def test_the_roll_outs_agree_for_one_member(windows: Windows):
    model = initial_networks(
        windows, Nominal(A1_BODY, (0.5, 0.9, 0.3)), replace(NETWORKS, seeds=1), np.random.default_rng(0)
    )
    batch = training.Batch.of(windows, torch.device("cpu"))
    states, _ = training.ResidualModule(model, 0.0).roll_out(batch)
    order = np.argsort(windows.start, kind="stable")
    np.testing.assert_allclose(states[0].detach(), model.predict(windows.inputs)[order, 1:], atol=1e-5)


def test_gradients_of_the_loss_by_finite_differences(windows: Windows):
    learner = training.ResidualModule(our_model(windows), 0.0).double()
    batch = training.Batch.of(windows.of_jumps(windows.jumps[:1]), torch.device("cpu"))
    batch = training.Batch(
        *(getattr(batch, n).double() for n in ("state", "force", "foot", "time_s", "step_s")), batch.in_contact
    )

    def loss() -> torch.Tensor:
        states, penalty = learner.roll_out(batch)
        return ((states - batch.state[:, 1:]) ** 2).mean() + 1e-3 * penalty

    loss().backward()
    for name in ("contact/h", "contact/G", "flight/h"):
        weight = learner.networks[name][0][0]
        with torch.no_grad():
            for index in ((0, 1, 2), (1, 4, 7)):
                kept, values = weight[index].item(), []
                for bump in (1e-5, -1e-5):
                    weight[index] = kept + bump
                    values.append(loss().item())
                weight[index] = kept
                assert (values[0] - values[1]) / 2e-5 == pytest.approx(weight.grad[index].item(), rel=1e-4, abs=1e-9)
