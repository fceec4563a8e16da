from pathlib import Path

import pytest
from recipes import bytes_of
from rendered_sets import SPLIT, TASKS, recipe_folder

from lemma.core.workers.pool import Serial
from lemma.dataset.recipe.files import REVISION_VARIABLE
from lemma.dataset.recipe.generate import GenerateConfig, generate
from lemma.dataset.rendered.capture import KeyframeForm
from lemma.dataset.rendered.render import RenderConfig, render
from lemma.policies.training.run import check_data


@pytest.mark.slow
@pytest.mark.render
def test_the_digest_of_data_is_of_what_decides_their_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def drawn(name: str, recipe: Path, height: int = 60) -> str:
        monkeypatch.setenv(REVISION_VARIABLE, name)
        order = RenderConfig(recipe=recipe, out=tmp_path / name)
        render(order, KeyframeForm(80, height), Serial())
        found: str = check_data(tmp_path / name, ["train"])["digest"]
        return found

    shorter = tmp_path / "recipe"
    generate(
        GenerateConfig(out=shorter, tasks=TASKS, splits=(SPLIT,), episodes=1), Serial()
    )
    digest = drawn("first", recipe_folder())
    # Another commit draws the same pictures into files with another name of it.
    assert drawn("later", recipe_folder()) == digest
    assert bytes_of(tmp_path / "later") != bytes_of(tmp_path / "first")
    assert drawn("shorter", shorter) != digest
    assert bytes_of(tmp_path / "shorter").keys() == bytes_of(tmp_path / "first").keys()
    assert drawn("larger", recipe_folder(), 90) != digest
