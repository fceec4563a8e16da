import json
import re
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from command import run
from PIL import Image

from lemma.env.episode import STILL_S
from lemma.tasks.suite import load_instance
from lemma.viz.annotate import ROBOT_INK
from lemma.viz.pages.demo import Illustration, write_page
from lemma.viz.pages.templates import jpeg
from lemma.viz.recording import Recording, record
from lemma.viz.video import VideoStyle, caption


@pytest.fixture(scope="module")
def recording() -> Recording:
    return record(load_instance("stack", "test", 0), frame_s=0.5)


def test_recording_says_what_was_done(recording: Recording) -> None:
    assert recording.success
    assert recording.failure is None
    assert [line.to_dict()["primitive"] for line in recording.lines] == ["move", "move"]
    first, second = recording.lines
    assert second.start_s == pytest.approx(first.start_s + first.duration_s)
    assert recording.elapsed_s == pytest.approx(second.start_s + second.duration_s)
    assert first.words.endswith("to the shared space")


def test_recording_has_frames_at_equal_times(recording: Recording) -> None:
    times = [time_s for time_s, _ in recording.frames]
    assert times == pytest.approx([0.5 * i for i in range(len(times))], abs=0.006)
    assert recording.elapsed_s - times[-1] < 0.51


def test_recording_without_frames() -> None:
    assert record(load_instance("stack", "test", 0), horizon_s=0.5).frames == ()


def test_out_of_time_is_a_failure() -> None:
    done = record(load_instance("stack", "test", 0), horizon_s=2.0)
    assert not done.success
    assert done.failure == "out_of_time"
    assert done.to_dict()["subtasks"][0]["outcome"] == "out_of_time"


def test_caption_follows_the_episode(recording: Recording) -> None:
    size = (704, 72)
    first, second = (
        np.asarray(caption(recording, step.start_s + 0.1, size))
        for step in recording.lines
    )
    end = np.asarray(caption(recording, recording.elapsed_s, size, ended=True))
    assert first.shape == (72, 704, 3)
    assert (first != second).any()
    assert (second != end).any()
    # The bar at the bottom is as long as the part that is over.
    for strip, share in ((first, 0.1 / recording.elapsed_s), (end, 1.0)):
        bar = (strip[-1] == strip[-1, 0]).all(axis=-1).mean()
        assert bar == pytest.approx(share, abs=0.01)


def test_caption_has_a_row_for_each_of_several_robots_at_work(
    recording: Recording,
) -> None:
    first, second = recording.lines
    assert first.subtask
    assert second.subtask
    at_once = replace(second, start_s=0.0, end_s=0.5 * recording.elapsed_s)
    held = 0.0, 0.25 * recording.elapsed_s
    both = replace(recording, lines=(replace(first, waits=(held,)), at_once))
    strip = np.asarray(caption(both, recording.elapsed_s, (704, 72), ended=True))
    robots = recording.instance.scene
    rows = [strip[-8 + 4 * number] for number in range(2)]
    colors = dict(zip(robots.robot_names, robots.robots, strict=True))
    for line in both.lines:
        assert line.subtask
        assert line.end_s
        row = rows[robots.robot_names.index(line.subtask.robot)]
        ink = np.array(ROBOT_INK[colors[line.subtask.robot].color])
        share = (row == ink).all(axis=-1).mean()
        works_s = line.end_s - (held[1] if line.waits else 0.0)
        assert share == pytest.approx(works_s / recording.elapsed_s, abs=0.02)


def test_caption_of_an_episode_in_which_nothing_was_done(recording: Recording) -> None:
    idle = replace(recording, lines=(), elapsed_s=0.0, success=False)
    assert caption(idle, 0.0, (704, 72), ended=True).size == (704, 72)


def test_page_shows_failures(recording: Recording, tmp_path: Path) -> None:
    (tmp_path / "stack.mp4").write_bytes(b"video")
    picture = jpeg(Image.new("RGB", (8, 8)))
    failed = replace(recording, success=False, failure="<dropped>")
    page = tmp_path / "index.html"
    seen = Illustration(tmp_path / "stack.mp4", picture, picture)
    write_page(page, [recording, failed], [seen, seen], speed=3)
    text = page.read_text()
    assert "1 of 2 instances" in text
    assert text.count("failed: &lt;dropped&gt;") == 2
    assert "<dropped>" not in text
    assert "data:video/mp4;base64,dmlkZW8=" in text


def test_demo_without_video(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("demo", "stack", "--robots", "ur10,ur5", "--no-video", "--json") == 0
    captured = capsys.readouterr()
    (result,) = json.loads(captured.out)
    assert result["team"] == "ur5+ur10"
    assert result["success"] is True
    assert len(result["subtasks"]) == 2
    said = [float(s) for s in re.findall(r"success +([\d.]+) s\n", captured.err)]
    durations = [subtask["duration_s"] for subtask in result["subtasks"]]
    assert said == pytest.approx(durations, abs=0.051)
    for subtask in result["subtasks"]:
        assert subtask["outcome"] == "success"
        assert f"{subtask['pick']} → {subtask['place']}" in captured.err


def test_demo_fails_if_the_expert_does(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("lemma.expert.expert.find_plan", lambda *_, **__: None)
    assert run("demo", "stack", "--no-video", "--json") == 1
    (result,) = json.loads(capsys.readouterr().out)
    assert result["success"] is False
    assert result["failure"] == "goal_not_reached"
    assert result["subtasks"] == []


@pytest.mark.slow
@pytest.mark.render
def test_demo_with_video(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("demo", "stack", "--seed", 0, "--out", tmp_path) == 0
    assert str(tmp_path / "index.html") in capsys.readouterr().out
    style = VideoStyle()
    with av.open(str(tmp_path / "stack.mp4")) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert stream.average_rate == style.frames_per_s
        frames = [
            frame.to_ndarray(format="rgb24") for frame in container.decode(stream)
        ]
    done = record(load_instance("stack", "free", 0))
    # The robots stand still before an episode is judged, which is seen but not counted.
    shown_s = done.elapsed_s + STILL_S
    expected = shown_s / style.frame_s + style.last_s * style.frames_per_s
    assert abs(len(frames) - expected) <= 3
    height = style.height_px + style.caption_px
    assert frames[0].shape == (height, style.width_px, 3)
    # Something moves in the picture, and the caption changes above it.
    change = abs(frames[0].astype(int) - frames[len(frames) // 2])
    assert change[style.caption_px :].max() > 100
    assert change[: style.caption_px].max() > 100
    page = (tmp_path / "index.html").read_text()
    assert len(page) < 3_000_000
    assert done.instance.instructions["high_level"] in page
    assert not re.search(r"https?://", page)
    sources = re.findall(r'(?:src|href|poster)="([^"]{0,20})', page)
    assert len(sources) >= 5
    replay = "replays/stack.html"
    assert all(source.startswith(("data:", "#", replay)) for source in sources)
    assert (replay in sources) is (tmp_path / replay).exists()
    assert not re.search(r"\$[a-z]", page)


def test_own_sentence_is_read_judged_and_done(
    capsys: pytest.CaptureFixture[str],
) -> None:
    # Another goal than the one of the instance, whose lower cube comes first too.
    pads = load_instance("pass2", "test", 1).goal.pairs
    said = f"Place the {pads[0][0]} on top of the {pads[0][1]}".replace("_", " ")
    assert (
        run("demo", "pass2", "--index", 1, "--no-video", "--say", said, "--json") == 0
    )
    told = capsys.readouterr()
    (done,) = json.loads(told.out)
    assert (done["success"], done["instruction"]) == (True, said)
    assert len(done["subtasks"]) == 2
    assert "Understood: the" in told.err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("stack", "--say", "Fetch me a coffee"), "none of them"),
        (
            ("--say", "Place the red cube on top of the blue cube"),
            "needs exactly one task",
        ),
    ],
)
def test_sentence_that_is_not_understood_is_refused(
    words: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("demo", *words, "--no-video") == 2
    assert says in capsys.readouterr().err
