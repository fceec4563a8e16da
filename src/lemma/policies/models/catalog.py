"""All models by name: importing this module fills the table of models."""

from dataclasses import asdict
from typing import Any

import lemma.policies.models.cliport.model
import lemma.policies.models.episodic_transformer
import lemma.policies.models.keypose
import lemma.policies.models.reachnet.model
import lemma.policies.models.team_reachnet.model  # noqa: F401
from lemma.core.arguments import decode
from lemma.policies.models.base import MODELS, Model


def make_model(name: str, options: dict[str, Any]) -> Model:
    """Return a model with new weights.

    Args:
        name: Name of the model, as in ``lemma train``.
        options: Fields of its dataclass of options, as plain data.

    Raises:
        UnknownNameError: There is no such model or option.
        InvalidConfigError: The value of an option is invalid.
    """
    model, config = MODELS[name]
    made: Model = model(decode(config, options))
    return made


def options_of(model: Model) -> dict[str, Any]:
    """Return the options of a model as plain data."""
    return asdict(model.config)


__all__ = ["MODELS", "make_model", "options_of"]
