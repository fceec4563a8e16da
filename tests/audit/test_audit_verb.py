"""`lemma audit`: what it prints, how it ends, and that it repeats."""

import errno
import json
from dataclasses import replace
from pathlib import Path

import pytest
from command import run
from own_plugins import EXAMPLES, loaded
from soft_tables import two_cubes_to_drag

from lemma.audit.attack import ATTACKS, Attack
from lemma.audit.control_trial import ControlTrial
from lemma.audit.run import audit, audit_instance, tally
from lemma.cli import audit as verb
from lemma.core.errors import DatasetError, PhysicsError
from lemma.core.workers.pool import ProcessPool
from lemma.tasks import suite
from lemma.tasks.suite import load_instance
from lemma.viz.video import VideoStyle

EPISODES = ("--episodes", "1", "--workers", "1")


def test_says_where_nothing_is_attacked(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--tasks", "lift,place", "--attacks", "drag_home, out_of_order")
    assert run("audit", *words, *EPISODES, "--json") == 0
    out, told = capsys.readouterr()
    for of_tasks in json.loads(out)["attacks"].values():
        assert list(of_tasks) == ["place"]
    assert "lift: not attacked, since one robot may do it alone" in told


def test_prints_one_json_object(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--tasks", "pass, hook", "--attacks", "drag_home, tilted_move, drag_home")
    run("audit", *words, *EPISODES, "--json")
    found = json.loads(capsys.readouterr().out)
    assert list(found) == ["attacks", "budgets"]
    assert list(found["budgets"]) == list(found["attacks"])
    budget = {"attempts": 6, "candidates": 1, "simulated_s": 100.0}
    assert found["budgets"]["tilted_move"] == {"level": "control", **budget}
    assert list(found["attacks"]) == ["drag_home", "tilted_move"]
    for of_tasks in found["attacks"].values():
        assert list(of_tasks) == ["pass", "hook"]
        for sums in of_tasks.values():
            keys = ["level", "tried", "executed", "succeeded", "best_progress"]
            assert list(sums) == [*keys, "simulated_s", "seconds"]
            assert sums["tried"] == 1


def test_the_table_tells_what_was_executed_from_what_geometry_gave_up(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # No stick is needed to pass a cube: geometry gives drags up there.
    (given_up,) = audit_instance(load_instance("pass", "test", 0), ["drag_home"])
    (acted,) = audit_instance(two_cubes_to_drag(), ["drag_home"])
    monkeypatch.setattr("lemma.audit.run.audit", lambda *args: [given_up, acted])
    run("audit", "--tasks", "pass", "--attacks", "drag_home, search", *EPISODES)
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    cells = [row[:-1] for row in rows if len(row) == 7]
    assert ["pass", "drag_home", "1", "0", "0", "0%"] in cells
    assert ["poke_stack", "drag_home", "1", "1", "1", "100%"] in cells
    # The most that each may take.
    assert ["search", "control", "3", "50", "150.0"] in rows


def test_leaves_with_1_if_an_attack_succeeded(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = list(audit_instance(two_cubes_to_drag(), ["drag_home"]))
    monkeypatch.setattr("lemma.audit.run.audit", lambda *args: found)
    assert run("audit", "--tasks", "poke_stack", *EPISODES) == 1
    told = capsys.readouterr()
    assert "poke_stack" in told.out
    assert "poke_stack/free/0: drag_home by robot_0" in told.err
    monkeypatch.setattr("lemma.audit.run.audit", lambda *args: [])
    assert run("audit", "--tasks", "poke_stack", *EPISODES) == 0


@pytest.mark.slow
def test_repeats_whoever_works() -> None:
    keys = [("hook_stack", "test", index) for index in range(2)]
    names = ("drag_home", "tilted_move")
    one, two = (audit(keys, names, ProcessPool(n)) for n in (1, 2))
    assert [(f.attack, f.succeeded, f.subtasks) for f in one] == [
        (f.attack, f.succeeded, f.subtasks) for f in two
    ]
    alike = [[replace(f, seconds=0.0) for f in found] for found in (one, two)]
    assert tally(alike[0]) == tally(alike[1])


@pytest.mark.slow
@pytest.mark.render
def test_a_video_is_written_of_a_success(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    soft = two_cubes_to_drag()
    monkeypatch.setattr(suite, "load_instance", lambda *key: soft)
    found = list(audit_instance(soft, ["drag_home"]))
    style = VideoStyle(width_px=96, height_px=64, caption_px=16, speed=20)
    verb.write_videos(found, tmp_path, style)
    video = tmp_path / "poke_stack-free-0-drag_home.mp4"
    assert video.stat().st_size > 1_000
    assert [*tmp_path.iterdir()] == [video]

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("av.open", full)
    with pytest.raises(DatasetError, match="disk is full"):
        verb.write_videos(found, tmp_path, style)
    assert [*tmp_path.iterdir()] == [video]


def test_an_attack_of_a_plugin_is_played(capsys: pytest.CaptureFixture[str]) -> None:
    with loaded(EXAMPLES / "14_write_an_attack.py"):
        run(
            "audit",
            "--tasks",
            "pass",
            "--attacks",
            "set_down_near",
            *EPISODES,
            "--json",
        )
    found = json.loads(capsys.readouterr().out)["attacks"]
    assert found["set_down_near"]["pass"]["tried"] == 1


def test_an_attempt_that_ends_in_unstable_physics_is_lost_and_told_of(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def blow_up(trial: ControlTrial) -> None:
        """Ends in unstable physics."""
        trial.wait(0.1)
        raise PhysicsError("unstable")

    attack = Attack(blow_up, "control", attempts=2)
    monkeypatch.setitem(ATTACKS._records, "blow_up", attack)
    found = list(audit_instance(load_instance("pass", "test", 0), ["blow_up"]))
    assert [(one.acted, one.succeeded, one.unstable) for one in found] == [
        (True, False, 4)
    ]
    monkeypatch.setattr("lemma.audit.run.audit", lambda *args: found)
    assert run("audit", "--tasks", "pass", *EPISODES) == 0
    words = " ".join(capsys.readouterr().err.split())
    assert "pass/test/0: blow_up made the physics unstable in 4 attempts" in words
