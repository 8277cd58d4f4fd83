"""All named models: the recipes in the files of the package ``models``, and those that other packages offer."""

from collections.abc import Iterable
from functools import cache
from pathlib import Path

from leapgap.errors import InputError
from leapgap.jumping.learning import models
from leapgap.jumping.learning.deviation_recipe import DeviationRecipe
from leapgap.jumping.learning.model import Model
from leapgap.jumping.learning.recipe import ModelRecipe, ModelSettings
from leapgap.registry import classes_by_name

ENTRY_POINTS = "leapgap.learned_models"
"""Entry-point group under which other packages provide recipes."""
DEVIATION_ENTRY_POINTS = "leapgap.deviation_models"


@cache
def recipes() -> dict[str, ModelRecipe]:
    """The recipe of every model by the model's name, in alphabetical order."""
    kinds = classes_by_name(models, ModelRecipe, ENTRY_POINTS)  # type: ignore[type-abstract]
    return {name: kind() for name, kind in kinds.items()}


@cache
def deviation_recipes() -> dict[str, DeviationRecipe]:
    """The recipes of models of the deviation from a plan, by their names."""
    kinds = classes_by_name(models, DeviationRecipe, DEVIATION_ENTRY_POINTS)  # type: ignore[type-abstract]
    return {name: kind() for name, kind in kinds.items()}


def find_recipe(name: str, where: Path | str) -> ModelRecipe:
    """The recipe of a model's name; ``InputError`` where there is none."""
    if name not in recipes():
        raise InputError(where, f"a model named {name}", f"some of {', '.join(recipes())}", "run stages.train again")
    return recipes()[name]


def settings_by_section() -> dict[str, type[ModelSettings]]:
    """Classes of the models' settings by their section of the configuration, in alphabetical order."""
    return by_section(recipes().values())


def by_section(named: Iterable[ModelRecipe | DeviationRecipe]) -> dict[str, type[ModelSettings]]:
    """The settings of some recipes by their section."""
    kinds = {recipe.settings for recipe in named if recipe.settings}
    sections: dict[str, type[ModelSettings]] = {}
    for kind in sorted(kinds, key=lambda kind: (kind.section, kind.__module__)):
        if kind.section in sections:
            where = f"{kind.__module__}.{kind.__qualname__}"
            raise InputError(where, f"the section {kind.section}", "a section of its own", "choose another")
        sections[kind.section] = kind
    return sections


def model_class(kind: str) -> type[Model]:
    """The class of a stored model; ``KeyError`` where no recipe fits such models."""
    return {recipe.model.kind: recipe.model for recipe in recipes().values()}[kind]
