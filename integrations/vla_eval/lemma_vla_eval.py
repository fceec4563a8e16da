"""LEMMA Bench as a benchmark of vla-eval, at control level.

docs/vla_eval.md describes observations and actions.
"""

import os
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from vla_eval.benchmarks.base import StepBenchmark, StepResult
from vla_eval.specs import IMAGE_RGB, LANGUAGE, DimSpec
from vla_eval.types import Action, EpisodeResult, Observation, Task

import lemma
from lemma.env.learning.flat_view import FlatView
from lemma.serve.vla_eval import format_of, observation, read_action
from lemma.tasks.instance import BENCHMARK_VERSION, SPLITS
from lemma.tasks.language.bank import robot_phrases
from lemma.tasks.suite import SUITE

_IMAGES = "observation.images."


class LemmaBenchmark(StepBenchmark):
    """Tasks of LEMMA with strict success, one episode for each instance of a split.

    Episode ``n`` of a task is instance ``n`` of its frozen list. It ends when the goal
    has held for half a second, or at T_max; if the harness ends it before, it is a
    failure.
    """

    render_backends = frozenset({"gpu", "cpu"})
    _ALL_RECORD_FIELDS = frozenset({"reward", "done", "success", "progress", "action"})

    @classmethod
    def configure_render(cls, mode: str) -> dict[str, str]:
        """Set Mesa to the CPU; the renderer chooses EGL or OSMesa by itself."""
        found = {"LIBGL_ALWAYS_SOFTWARE": "1"} if mode == "cpu" else {}
        os.environ.update(found)
        return found

    def __init__(  # noqa: PLR0913 - by name, all have a default
        self,
        tasks: Sequence[str] = SUITE,
        split: str = "test",
        control: str = "joint_position",
        control_hz: float = 20.0,
        cameras: Sequence[str] | None = None,
        width: int = 224,
        height: int = 224,
        state: Sequence[str] = ("agent_pos",),
        send_state: bool = True,
        **options: Any,
    ) -> None:
        """Store the options; the simulation starts with the first episode.

        Args:
            tasks: Names of tasks.
            split: Frozen list of instances.
            control: Meaning of an action, see ``lemma.env.control.modes.CONTROLS``.
            control_hz: Actions per simulated second [Hz].
            cameras: Names of the cameras; the usual ones of the control level if None.
            width: Width of images [px].
            height: Height of images [px].
            state: Parts of the state, see
                ``lemma.env.learning.flat_view.STATES``.
            send_state: Whether to send the state.
            options: Other options of :class:`lemma.env.config.EnvConfig`, such as
                ``instruction`` and ``horizon_s``.

        Raises:
            LemmaError: There is no such task, split, camera or option.
        """
        super().__init__()
        self._tasks = (tasks,) if isinstance(tasks, str) else tuple(tasks)
        self._send_state, self._state = send_state, tuple(state)
        self._options = {
            "clip_actions": True,
            **options,
            "level": "control",
            "observation": "rgb",
            "split": split,
            "control": control,
            "control_hz": control_hz,
            "cameras": None if cameras is None else tuple(cameras),
            "width": width,
            "height": height,
        }
        self._split, self._control = split, control
        self._env = self._make(self._tasks[0])

    def _make(self, task: str) -> FlatView:
        env = FlatView(lemma.make(task, **self._options), self._state)
        self._playing = task
        return env

    def get_tasks(self) -> list[Task]:
        """Return the tasks; vla-eval adds the number of the episode."""
        return [
            {"name": name, "suite": "lemma", "task_id": name, "split": self._split}
            for name in self._tasks
        ]

    def reset(self, task: Task) -> dict[str, np.ndarray]:
        """Begin an episode."""
        if task["task_id"] != self._playing:
            self._env.close()
            self._env = self._make(task["task_id"])
        seen, _ = self._env.reset(options={"index": int(task["episode_idx"])})
        self._film(seen)
        return seen

    def step(self, action: Action) -> StepResult:
        """Command the motors for one control step.

        Raises:
            PolicyFailedError: The action is invalid; the episode has failed.
        """
        row = read_action(action, self._env.action_names)
        seen, reward, terminated, truncated, info = self._env.step(row)
        done = terminated or truncated
        self._film(seen)
        self._recorder.record_step(
            reward=reward,
            done=done,
            success=done and info["is_success"],
            progress=info["progress"],
            action=row.astype(np.float32),
        )
        return StepResult(seen, reward, done, info)

    def _film(self, seen: dict[str, np.ndarray]) -> None:
        images = (image for name, image in seen.items() if name.startswith(_IMAGES))
        self._recorder.record_video(next(images))

    def make_obs(self, raw_obs: dict[str, np.ndarray], task: Task) -> Observation:
        """Return images, instruction and state."""
        images = {
            name.removeprefix(_IMAGES): image
            for name, image in raw_obs.items()
            if name.startswith(_IMAGES)
        }
        state = raw_obs["observation.state"] if self._send_state else None
        robots = robot_phrases(self._inner.instance.scene.robots)
        return observation(images, self._inner.task_description, state, robots)

    def get_step_result(self, step_result: StepResult) -> EpisodeResult:
        """Return the outcome of the episode."""
        info = step_result.info
        return {
            "success": bool(step_result.done and info["is_success"]),
            "progress": float(info["progress"]),
            "elapsed_s": float(info["elapsed_s"]),
            "idle_s": float(np.mean(list(info["idle_s"].values()))),
            "fallen": len(info["fallen"]),
        }

    def get_metric_keys(self) -> dict[str, str]:
        """Return the aggregated metrics, with their aggregation."""
        return dict.fromkeys(("success", "progress", "elapsed_s", "idle_s"), "mean")

    def get_metadata(self) -> dict[str, Any]:
        """Return the durations of an episode and of an action."""
        return {
            "max_steps": self._inner._max_episode_steps,
            "max_episodes_per_task": SPLITS.get(self._split),
            "action_dim": len(self._env.action_names),
            "action_names": list(self._env.action_names),
            "state_names": list(self._env.state_names),
            "benchmark_version": BENCHMARK_VERSION,
        }

    def get_action_spec(self) -> dict[str, DimSpec]:
        """Return the specification of an action: a row in the control mode's units."""
        names, own = self._env.action_names, format_of(self._control)
        return {
            "actions": DimSpec(
                "actions",
                len(names),
                own,
                accepts=frozenset({own, "raw"}),
                description=f"{', '.join(names)}; units: docs/environments.md",
            )
        }

    def get_observation_spec(self) -> dict[str, DimSpec]:
        """Return the specification of observations."""
        seen = self._env.observation_space
        assert isinstance(seen, gymnasium.spaces.Dict)
        cameras = [n.removeprefix(_IMAGES) for n in seen if n.startswith(_IMAGES)]
        # Servers that accept any camera request "image".
        spec = dict.fromkeys(("image", *cameras), IMAGE_RGB)
        spec["language"] = LANGUAGE
        if self._send_state:
            names = self._env.state_names
            spec["state"] = DimSpec(
                "state", len(names), "raw", description=", ".join(names)
            )
        return spec

    @property
    def _inner(self) -> Any:
        return self._env.unwrapped

    def cleanup(self) -> None:
        """Free the resources of the rendering."""
        self._env.close()
