"""Replay the expert's motor commands in many worlds: how far they are from the CPU.

python scripts/measure_worlds.py [WORLDS] [TASK ...]

Speed is measured by `lemma bench --gpu`.
"""

import sys

import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp

import lemma
from lemma.core.poses import FloatArray
from lemma.env.episode import Episode
from lemma.warp.vector_env import GpuVecEnv


def sync(env: GpuVecEnv) -> None:
    """Wait for the device."""
    wp.synchronize()
    if env.device.startswith("cuda"):
        torch.cuda.synchronize()


def parity(task: str, worlds: int) -> None:
    """Print how far worlds are from the CPU after the same motor commands."""
    env = GpuVecEnv(task, worlds, pool=1, control_hz=100.0, seed=7)
    env.reset()
    episode = Episode(env.pool.instances[0])
    expert = lemma.Expert(episode.simulation.scene, episode.instance.goal)
    scene = episode.simulation.scene
    log: list[FloatArray] = []
    begin = scene.data.qpos.copy()
    noted = scene.coasting.note

    def note() -> None:
        log.append(scene.data.ctrl.copy())
        noted()

    scene.coasting.note = note  # type: ignore[method-assign]
    list(lemma.solve(episode, expert))
    mine = {name: scene.qpos_of(name) for name in scene.movable_names}
    names = {p.name: p.pose for p in episode.instance.scene.objects}
    slots: dict[int, str] = {}
    for k in env.pool.scene.movable_names:
        at = env.pool.scene.qpos_of(k)
        here = env.pool.rows["qpos"][0][at : at + 2]
        slots[at] = min(mine, key=lambda n: np.hypot(*(here - names[n].xy)))
    for at, name in slots.items():
        env.qpos[:, at : at + 7] = torch.tensor(
            begin[mine[name] : mine[name] + 7], device=env.device
        )
    env.qpos[1:, list(slots)] += 0.0005 * torch.randn_like(env.qpos[1:, list(slots)])
    commands = torch.tensor(np.array(log), dtype=torch.float32, device=env.device)
    with wp.ScopedDevice(env.device):
        mjw.step(env.model, env.data)
        graph, stream = None, None
        if env.device.startswith("cuda"):
            with wp.ScopedCapture() as capture:
                mjw.step(env.model, env.data)
            graph = capture.graph
            stream = wp.stream_from_torch(torch.cuda.current_stream())
            sync(env)
        for row in commands[1:]:
            env.ctrl[:] = row
            if graph is None:
                mjw.step(env.model, env.data)
            else:
                wp.capture_launch(graph, stream=stream)
    sync(env)
    for at, name in slots.items():
        end = torch.tensor(scene.position(name), device=env.device)
        off = torch.linalg.vector_norm(env.qpos[:, at : at + 3] - end, dim=1)
        print(
            f"{task}, {name}: median {1e3 * float(off.median()):.2f} mm, within 15 mm "
            f"{float((off < 0.015).float().mean()):.1%}; CPU success "
            f"{episode.is_success}",
            flush=True,
        )


if __name__ == "__main__":
    given = sys.argv[1:]
    worlds = int(given[0]) if given else 1024
    for each in given[1:] or ["stack", "lift_varied", "reach_varied"]:
        parity(each, worlds)
