"""No word of the blind instructions reaches anything that learns."""

from pathlib import Path

import pytest
import tiny_model
from painted_keyframes import write_painted
from recipes import made_up
from tiny_model import config

from lemma.core.errors import InvalidConfigError
from lemma.core.seeding import stream
from lemma.dataset.instructions import Language
from lemma.policies.frames import Frames
from lemma.policies.text.grammar import grammar
from lemma.policies.text.instructions import with_instructions
from lemma.policies.text.paraphrase import paraphrase
from lemma.policies.text.words import Vocabulary, _neighbours, neighbours
from lemma.policies.training.loop import train
from lemma.tasks.language import blind
from lemma.tasks.language.bank import vocabulary
from lemma.tasks.language.blind import instruction
from lemma.tasks.suite import SUITE, load_instance

tiny_model.register()


def sealed() -> None:
    pytest.fail("The blind instructions were opened.")


@pytest.fixture(autouse=True)
def seal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let whoever opens the blind instructions fail."""
    monkeypatch.setattr(blind, "_as_written", sealed)
    blind._drawn.cache_clear()
    _neighbours.cache_clear()
    grammar.cache_clear()


def test_the_seal_holds() -> None:
    with pytest.raises(pytest.fail.Exception, match="were opened"):
        instruction(load_instance("stack", "test", 0), "blind")


def test_vocabulary_paraphrases_and_sentences_do_without_them() -> None:
    assert set(Vocabulary().words) <= {*vocabulary(), *grammar().words}
    assert any(neighbours(word) for word in vocabulary())
    for task in SUITE:
        record = made_up(task, "train", 1)
        assert Language(instructions="resampled").choose(record)
        goal = load_instance(task, "train", 1).goal.pairs
        assert all(paraphrase(task, goal, stream("sealed", i)) for i in range(20))


def test_training_does_without_them(tmp_path: Path) -> None:
    data = write_painted(tmp_path / "data", {"train": 4, "val": 2})
    for split in ("train", "val"):
        frames = Frames.load(data, split)
        batch = with_instructions(frames.batch(range(len(frames))), 0, 0)
        mixed = with_instructions(batch, 0, 0, paraphrases=1.0)
        assert all(batch.instructions)
        assert all(mixed.instructions)
    train(config(data, tmp_path / "run"))


def test_training_refuses_the_kind(tmp_path: Path) -> None:
    with pytest.raises(InvalidConfigError, match="valid: high_level, human"):
        config(tmp_path, tmp_path / "run", kinds=("human", "blind"))
