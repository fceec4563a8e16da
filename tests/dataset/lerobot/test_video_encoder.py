"""No frame is dropped; `make test-lerobot` shows it with lerobot's own encoder."""

from queue import Full, Queue
from threading import Thread
from time import sleep
from typing import Any

import pytest

from lemma.core.errors import DatasetError
from lemma.dataset.lerobot.video_encoder import waiting

FRAMES = 12


class Hurried:
    """Stands for lerobot's encoder: drops what does not fit into its queue at once."""

    def __init__(self) -> None:
        self.seen: list[int] = []
        self._dropped_frames: dict[str, int] = {}
        self._frame_queues: dict[str, Queue[int | None]] = {"front": Queue(2)}
        self._threads = {"front": Thread(target=self._encode, daemon=True)}
        self._threads["front"].start()

    def _encode(self) -> None:
        while (frame := self._frame_queues["front"].get()) is not None:
            sleep(0.01)
            self.seen.append(frame)

    def feed_frame(self, video_key: str, image: int) -> None:
        try:
            self._frame_queues[video_key].put_nowait(image)
        except Full:
            self._dropped_frames[video_key] = 1

    def finish_episode(self) -> list[int]:
        self._frame_queues["front"].put(None)
        # As lerobot after two minutes: what is not encoded by then is lost.
        self._threads["front"].join(timeout=0.0)
        return [*self.seen]


def test_it_waits_for_the_encoder() -> None:
    hurried = Hurried()
    for number in range(FRAMES):
        hurried.feed_frame("front", number)
    assert len(hurried.finish_episode()) < FRAMES
    patient: Any = waiting(Hurried)()
    for number in range(FRAMES):
        patient.feed_frame("front", number)
    assert patient.finish_episode() == [*range(FRAMES)]


def test_what_was_dropped_all_the_same_is_an_error() -> None:
    patient: Any = waiting(Hurried)()
    patient._dropped_frames["front"] = 1
    with pytest.raises(DatasetError, match="dropped frames of front"):
        patient.finish_episode()


def test_an_encoder_that_died_is_not_waited_for() -> None:
    patient: Any = waiting(Hurried)()
    patient._frame_queues["front"].put(None)
    patient._threads["front"].join()
    for number in range(FRAMES):
        patient.feed_frame("front", number)
    assert patient._dropped_frames["front"] == 1
