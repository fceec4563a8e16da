"""`lemma render`: its options, for every form."""

import sys
from pathlib import Path

import pytest
from command import run
from rendered_sets import recipe_folder

from lemma.cli import render as verb
from lemma.cli.render import RenderOptions, choose_form
from lemma.cli.workers import Workers
from lemma.core.workers.pool import Serial
from lemma.dataset.lerobot.export import LeRobotConfig
from lemma.dataset.lerobot.frames import Style
from lemma.dataset.rendered.render import RenderConfig, RenderSummary
from lemma.tasks.language.template import KINDS

FORMS = ("keyframes", "lerobot")


@pytest.mark.slow
def test_without_the_lerobot_package_it_is_said_how_to_get_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "lerobot", None)
    words = (recipe_folder(), "--out", tmp_path / "set", "--form", "lerobot")
    assert run("render", *words, "--workers", "1") == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "pip install 'lemma-bench[lerobot]'" in told
    assert "Python 3.12" in told
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize("form", FORMS)
def test_every_form_works_where_it_is_told_and_can_be_interrupted(
    form: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    engine = Serial()
    given: list[object] = []

    def make(*arguments: object) -> RenderSummary:
        *rest, advance = arguments
        given.extend(rest)
        assert callable(advance)
        advance(3)
        raise KeyboardInterrupt

    monkeypatch.setattr(Workers, "make_engine", lambda self: engine)
    monkeypatch.setattr(verb, "write_dataset", make)
    monkeypatch.setattr(verb, "render_form", make)
    assert (
        run("render", recipe_folder(), "--out", tmp_path / "set", "--form", form) == 130
    )
    assert given[-1] is engine
    told = capsys.readouterr().err
    assert "Interrupted: 3 of 4 episodes are saved" in " ".join(told.split())


def test_a_data_set_is_filmed_as_the_options_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    styles: list[Style] = []

    def keep(order: LeRobotConfig, *rest: object) -> None:
        styles.append(order.style)

    monkeypatch.setattr(verb, "write_dataset", keep)
    monkeypatch.setattr(verb, "choose_renderer", lambda name: f"chosen {name}")
    order = RenderConfig(recipe=tmp_path, out=tmp_path / "set")
    other = RenderOptions(
        size="160x120",
        fps=20,
        no_depth=True,
        cameras="overview,robot_1_wrist",
        instructions="high-level,human",
        renderer="opengl",
    )
    for look in (RenderOptions(), other, RenderOptions(instructions="all")):
        choose_form("lerobot", order, look)(Serial(), lambda count: None)
    assert styles == [
        Style(renderer="chosen auto"),
        Style(
            fps=20,
            width_px=160,
            height_px=120,
            depth=False,
            cameras=("overview", "robot_1_wrist"),
            instructions=("high_level", "human"),
            renderer="chosen opengl",
        ),
        Style(instructions=KINDS, renderer="chosen auto"),
    ]
