"""Videos that lack no frame, however slow the machine is.

While it streams, lerobot drops frames that its encoder has no time for, because cameras
of real robots do not wait; all frames that follow are then seen one too early. Whoever
renders can wait.
"""

from contextlib import suppress
from importlib import import_module
from queue import Full
from time import sleep
from typing import Any

from lemma.core.errors import DatasetError

_LOOK_S = 0.001
_WAITS = "_waits_for_encoders"


def encode_whole_videos() -> None:
    """Replace the streaming encoder of the lerobot package; once is enough."""
    module = import_module("lerobot.datasets.lerobot_dataset")
    kind = module.StreamingVideoEncoder
    if not hasattr(kind, _WAITS):
        vars(module)["StreamingVideoEncoder"] = waiting(kind)


def waiting(kind: type) -> type:
    """Return a kind of streaming encoder that waits where it would drop a frame.

    Args:
        kind: The one of lerobot.
    """

    class Waiting(kind):  # type: ignore[misc]
        _waits_for_encoders = True

        def feed_frame(self, video_key: str, image: Any) -> None:
            # Nobody else fills the queue: where there is room, there stays some.
            while self._frame_queues[video_key].full() and self._works(video_key):
                sleep(_LOOK_S)
            super().feed_frame(video_key, image)

        def finish_episode(self) -> Any:
            # It would give encoders two minutes for what is left.
            for video_key, queue in self._frame_queues.items():
                told = False
                while not told and self._works(video_key):
                    with suppress(Full):
                        queue.put(None, timeout=_LOOK_S)
                        told = True
                self._threads[video_key].join()
            lost = [name for name, count in self._dropped_frames.items() if count]
            if lost:
                raise DatasetError(
                    f"lerobot has dropped frames of {', '.join(lost)}. Export again."
                )
            return super().finish_episode()

        def _works(self, video_key: str) -> bool:
            works: bool = self._threads[video_key].is_alive()
            return works

    return Waiting
