"""All named models. A new one is a ``ModelRecipe`` in a file of its own, and its file in the list below."""

from pathlib import Path

from leapgap.errors import InputError
from leapgap.jumping.learning import (
    constant_velocity,
    ensemble,
    kernel,
    nominal,
    playback,
    published_recipe,
    residual_networks,
)
from leapgap.jumping.learning.model import Model
from leapgap.jumping.learning.recipe import ModelRecipe

FILES = (nominal, constant_velocity, playback, kernel, residual_networks, ensemble, published_recipe)
RECIPES: dict[str, ModelRecipe] = {recipe.name: recipe for file in FILES for recipe in file.RECIPES}
"""Every model, by the key of its figures."""


def find_recipe(name: str, where: Path | str) -> ModelRecipe:
    """The recipe of a model's name; ``InputError`` where there is none."""
    if name not in RECIPES:
        raise InputError(where, f"a model named {name}", f"some of {', '.join(RECIPES)}", "run stages.train anew")
    return RECIPES[name]


def model_class(kind: str) -> type[Model]:
    """The class of a stored model; ``KeyError`` where no recipe fits such models."""
    return {recipe.model.kind: recipe.model for recipe in RECIPES.values()}[kind]
