"""A robot that a visitor leads, and what is kept of it."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from looked_at import STACK, player_of, until

from lemma import make
from lemma.core.errors import InvalidConfigError
from lemma.evaluation.run.loading import load_policy
from lemma.policies.control.recorded import Recorded
from lemma.policies.spec import PolicySpec
from lemma.tasks.instance import Instance
from lemma.viewer.episode.by_hand import BY_HAND
from lemma.viewer.episode.session import Session

WISH = replace(STACK, policy=BY_HAND)
STEPS = 30


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    found = Session(WISH, ("oracle", BY_HAND), player_of())
    found.ask(WISH, acts=True)
    until(lambda: found.hand.target(0) is not None, found.play)
    goal = found.hand.target(0)
    assert goal is not None
    found.hand.lead(0, goal[:3] - (0.0, 0.1, 0.1), goal[3:7])
    found.hand.grip(0, opened=False)
    until(lambda: found.play.transport.cursor_s > 3.0, found.play)
    found.play.transport.pause()
    yield found
    found.close()


@pytest.fixture(scope="module")
def file(session: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    assert session.play.instance is not None
    recording = session.hand.recording(session.play.instance)
    path = tmp_path_factory.mktemp("hand") / "mine.json"
    path.write_text(recording.to_json())
    return path


def test_hand_goes_where_it_is_led(session: Session) -> None:
    assert session.play.rollout is not None
    arm = session.play.rollout.episode.simulation.arms["robot_0"]
    goal = session.hand.target(0)
    assert goal is not None
    assert arm.tcp_pose()[:3, 3] == pytest.approx(goal[:3], abs=0.02)
    assert arm.scene.opening_m(arm.robot) < 0.01


def test_what_was_done_is_done_again_to_the_bit(session: Session, file: Path) -> None:
    name = f"{Recorded.__module__}:{Recorded.__name__}"
    arguments = (("file", str(file)),)
    policy = load_policy(
        PolicySpec(name, level="control", arguments=arguments, timeout_s=0)
    )
    instance = Instance.load(file)
    options = {**policy.control_options, "split": "free"}
    env: Any = make("stack", **options)
    env.reset(options={"instance": instance})
    for step in range(STEPS):
        (answer,) = policy.act([SimpleNamespace(step=step)])
        env.step(answer.rows)
    session.play.transport.seek(STEPS / 20.0)
    seen = session.play.transport.qpos()
    assert seen is not None
    again = env.unwrapped.episode.simulation.scene.data.qpos
    assert np.array_equal(seen, again)
    env.close()


@pytest.mark.parametrize("actions", [None, {}, {"rows": []}, [[1.0]]])
def test_file_without_commands_is_refused(actions: object, tmp_path: Path) -> None:
    path = tmp_path / "bad.json"
    table = STACK.instance().to_dict()
    path.write_text(json.dumps({**table, "actions": actions}))
    assert Instance.load(path)
    with pytest.raises(InvalidConfigError, match="no motor commands"):
        Recorded(str(path))
