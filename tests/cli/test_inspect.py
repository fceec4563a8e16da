"""What `lemma inspect` prints, writes and draws."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from in_process import Serial
from PIL import Image

from lemma.cli.main import main
from lemma.dataset.recipe.balance import Balance, Evenness
from lemma.dataset.recipe.generate import GenerateConfig, generate
from lemma.viz.pages.dataset import p_words, verdict_words


@pytest.fixture(scope="module")
def recipe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two episodes of pass and two of stack."""
    folder = tmp_path_factory.mktemp("recipe") / "<small> & odd"
    order = GenerateConfig(
        out=folder, tasks=("pass", "stack"), splits=("val",), episodes=2
    )
    generate(order, Serial())
    return folder


def run(*words: object) -> int | str | None:
    with pytest.raises(SystemExit) as end:
        main(["inspect", *(str(word) for word in words)])
    return end.value.code


def test_numbers_as_json(
    recipe: Path,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(recipe, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["total"]["episodes"] == found["total"]["solved"] == 4
    assert found["tasks"]["pass"]["subtasks"]["mean"] == 2.0
    assert found["splits"]["val"]["episodes"] == 4
    assert sum(team["episodes"] for team in found["teams"].values()) == 4
    assert found["versions"]["benchmark"] == "v1"
    assert found["evenness"]["even"] is True
    assert list(tmp_path.iterdir()) == []


def test_one_task_alone(recipe: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(recipe, "--task", "stack", "--split", "val", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found["tasks"]) == ["stack"]
    assert found["total"]["episodes"] == 2


def test_tables_fit_a_terminal(
    recipe: Path,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert run(recipe, "--out", tmp_path / "page.html") == 0
    text = capsys.readouterr().out
    for heading in ("episodes", "sub-tasks", "distractors", "margin"):
        assert heading in text
    assert "…" not in text
    assert re.search(r"^ all +4 +100% +2\.00 ", text, re.MULTILINE)
    assert "Too few episodes to say" in text
    assert text.endswith(f"page       {tmp_path / 'page.html'}\n")


class Page(HTMLParser):
    """Checks that all elements are closed, and keeps texts and attributes."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.texts: list[str] = []
        self.labels: list[str] = []
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "link"):
            self.open.append(tag)
        for name, value in attrs:
            assert value != ""
            if name == "aria-label":
                self.labels.append(value or "")
            if name in ("src", "href"):
                self.links.append(value or "")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in ("meta", "link"):
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if data.strip():
            self.texts.append(data.strip())


def read(page: str) -> Page:
    parser = Page()
    parser.feed(page)
    parser.close()
    assert parser.open == []
    return parser


def test_the_page_is_whole_and_needs_nothing_else(recipe: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "page.html"
    assert run(recipe, "--out", out) == 0
    page = read(out.read_text(encoding="utf-8"))
    assert "Recipe <small> & odd" in page.texts
    assert page.links == ["data:,"]
    assert {"share of tables [%]", "share of episodes [%]"} <= set(page.labels)
    assert "simulated time" in page.labels
    # Axes have units.
    assert {
        "simulated time [s]",
        "distance to the edge of reach [cm]",
    } <= (set(page.texts))
    assert {"by task", "by split", "by team", "gripper poses"} <= set(page.texts)
    for task in ("pass", "stack"):
        assert task in page.texts
    # In the details, by task, split and team.
    assert any(text.startswith("stack/val/ur") for text in page.texts)
    assert "$" not in "".join(page.texts)


@pytest.mark.render
def test_one_episode_as_pictures(
    recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "episode.png"
    words = ("--task", "stack", "--split", "val", "--index", 1, "--out", out)
    assert run(recipe, *words) == 0
    text = capsys.readouterr().out
    assert "v1/stack/val/1" in text
    assert "solved after" in text
    assert "shared space" in text.replace("\n", " ")
    picture = Image.open(out).convert("RGB")
    # Three keyframes in one row.
    assert picture.width > 3 * 600
    assert picture.height < 700
    tile = picture.crop((36, 138, 36 + 620, 138 + 400))
    last = picture.crop((36 + 1280, 138, 36 + 1280 + 620, 138 + 400))
    assert len(tile.getcolors(tile.width * tile.height) or ()) > 100
    assert tile.tobytes() != last.tobytes()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--index", "1"), "Say which with --task"),
        (("--task", "stack", "--index", "0"), "no episode stack/test/0"),
        (("--task", "hook"), "no episodes of task hook"),
        (("--split", "train"), "and split train"),
    ],
)
def test_what_is_not_there_is_explained(
    recipe: Path,
    words: tuple[str, ...],
    message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(recipe, *words) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert message in printed.err
    assert printed.err.count("\n") == 1


def test_no_recipe_is_explained(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path / "none") == 2
    assert "lemma generate" in capsys.readouterr().err


# Charts.


def test_p_values_in_words() -> None:
    for p_value, words in ((0.5, "0.50"), (0.0099, "<0.01"), (None, "–")):
        assert p_words(Balance("team", {}, p_value)) == words


def test_the_verdict_in_words() -> None:
    assert "is even within" in verdict_words(Evenness(46, 0.03, 0.0002))
    assert "is not even" in verdict_words(Evenness(46, 0.0001, 0.0002))
    assert "Too few" in verdict_words(Evenness(0, None, 0.01))
