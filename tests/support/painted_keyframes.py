"""Keyframes that are painted, not rendered: files as `lemma render` writes them.

Two robots, two cubes and a pad; the one cube is handed over and put on the pad, or on
the other cube. Labels are exact, and every object shows its palette color.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lemma.core.files import sha256_of, write_json
from lemma.core.seeding import stream
from lemma.dataset.files import MANIFEST
from lemma.dataset.rendered.keyframes import (
    FORM,
    KEYFRAMES_VERSION,
    Header,
    write_keyframes,
)
from lemma.scene.objects.entity import ENTITIES
from lemma.scene.objects.palette import OBJECT_COLORS, STICK, TABLE
from lemma.scene.raster import Raster
from lemma.tasks.instance import BENCHMARK_VERSION
from lemma.tasks.language.bank import instruct, robot_phrases_in_order, sub_instruction

RASTER = Raster(rows=144, columns=208, cell_m=0.008, floor_m=-0.1)
SMALL = Raster(rows=36, columns=52, cell_m=0.032, floor_m=-0.1)
FRAMES = 3
CUBE_HALF_M, PAD_RADIUS_M = 0.025, 0.060
TEAMS = (("red", "white"), ("white", "red"), ("red", "red"))
_SHARED_M = (0.0, 0.1)
_PERTURBED = {"perturb": "0.3", "perturb_seed": "0"}
_VERSIONS = {"benchmark": BENCHMARK_VERSION, "lemma": "0.0.0"}

Row = dict[str, Any]


@pytest.fixture(scope="session", name="data")
def painted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set to train on."""
    folder = tmp_path_factory.mktemp("painted")
    return write_painted(folder, {"train": 10, "val": 4})


@pytest.fixture(scope="session", name="recovery")
def painted_recovery(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Perturbed executions of the same episodes."""
    folder = tmp_path_factory.mktemp("perturbed")
    return write_painted(folder, {"train": 6, "val": 2}, perturbed=True)


def write_painted(
    folder: Path,
    splits: dict[str, int],
    raster: Raster = SMALL,
    *,
    perturbed: bool = False,
) -> Path:
    """Write painted keyframes.

    Args:
        folder: Where to.
        splits: Number of episodes of each split.
        raster: Of the maps.
        perturbed: Whether other sub-tasks were executed than the labels say.
    """
    files = {}
    versions = {**_VERSIONS, **(_PERTURBED if perturbed else {})}
    for split, episodes in splits.items():
        path = folder / "maps" / split / "stack-000.arrow"
        header = Header(
            form=FORM,
            part="maps",
            version=KEYFRAMES_VERSION,
            versions=versions,
            renderer="painted",
            robots=2,
            width=0,
            height=0,
            raster=raster,
            entities=ENTITIES,
            digests=("",) * episodes,
            keyframes=(FRAMES,) * episodes,
        )
        rows = [row for i in range(episodes) for row in episode(split, i, raster)]
        if perturbed:
            rows = [row | mistaken(row) for row in rows]
        write_keyframes([(path, header)], rows)
        name = path.relative_to(folder).as_posix()
        files[name] = {"sha256": sha256_of(path), "bytes": path.stat().st_size}
    about = {"form": FORM, "versions": versions, "renderer": "painted"}
    write_json(folder / MANIFEST, {"form": FORM, "about": about, "files": files})
    return folder


def mistaken(row: Row) -> Row:
    """Return what was executed, if the other robot did it and put it elsewhere."""
    moves = row["primitive"] == "move"
    return {
        "executed_robot": {"robot_0": "robot_1", "robot_1": "robot_0", "": ""}[
            row["robot"]
        ],
        "executed_primitive": row["primitive"],
        "executed_pick": row["pick"],
        "executed_place": "green_pad" if moves else "",
        "perturbation": "choice" if moves else "none",
    }


def episode(split: str, index: int, raster: Raster) -> list[Row]:
    """Return the keyframes of one episode."""
    draws = stream("painted", split, index)
    colors = list(OBJECT_COLORS)
    first, second, pad = (colors[i] for i in draws.permutation(len(colors))[:3])
    stack = bool(index % 2)
    cube, other = f"{first}_cube", f"{second}_cube"
    goal_entity = other if stack else f"{pad}_pad"
    task = "stack" if stack else "pass"
    goal = ((cube, goal_entity),)
    team = TEAMS[index % len(TEAMS)]
    start = (*draws.uniform((-0.45, -0.3), (-0.2, -0.1)), draws.uniform(-3, 3))
    ends = {
        other: (*draws.uniform((0.2, -0.3), (0.35, -0.15)), draws.uniform(-3, 3)),
        f"{pad}_pad": (*draws.uniform((0.2, 0.15), (0.35, 0.3)), draws.uniform(-3, 3)),
    }
    on_top = ends[goal_entity]
    places = (start, (*_SHARED_M, start[2]), on_top)
    steps = [
        ("robot_0", "move", cube, "shared", start, places[1]),
        ("robot_1", "move", cube, goal_entity, places[1], on_top),
        ("", "stop", "", "", None, None),
    ]
    rows = []
    for number, (robot, primitive, pick, place, grasp, end) in enumerate(steps):
        z = 0.025
        if number == 2:
            z = 0.075 if stack else 0.029
        poses = {name: (x, y, 0.025, yaw) for name, (x, y, yaw) in ends.items()}
        poses[f"{pad}_pad"] = (*ends[f"{pad}_pad"][:2], 0.0, ends[f"{pad}_pad"][2])
        poses[cube] = (*places[number][:2], z, places[number][2])
        poses["stick"] = (-0.1, -0.45, 0.015, 0.0)
        rgb, height = paint(poses, team, raster)
        seen: NDArray[np.bool_] = np.any(rgb, -1)
        phrases = robot_phrases_in_order(team)
        words = (
            sub_instruction(phrases[int(robot[-1])], primitive, pick, place)
            if robot
            else sub_instruction("", "stop")
        )
        rows.append(
            {
                "key": f"v1/{task}/{split}/{index}",
                "task": task,
                "split": split,
                "index": index,
                "keyframe": number,
                "keyframes": FRAMES,
                "time_s": float(number),
                "team": "ur5+ur10",
                "arms": "ur5+ur10" if index % 2 else "ur10+ur5",
                "bases": np.array([[-0.6, 0.05, 0.1], [0.65, -0.02, math.pi - 0.1]]),
                **{
                    kind: instruct(task, kind, goal, draws)
                    for kind in ("high_level", "human", "unseen")
                },
                "goal": json.dumps(goal),
                "robot": robot,
                "primitive": primitive,
                "pick": pick,
                "place": place,
                "pick_pose": np.array(grasp or (np.nan,) * 3),
                "place_pose": np.array(end or (np.nan,) * 3),
                "sub_instruction": words,
                "outcome": "success" if robot else "stopped",
                "joints": draws.uniform(-2, 2, (2, 6)),
                "opening_m": draws.uniform(0, 0.1, 2),
                "objects": _rows_of(poses),
                "instance": json.dumps({"robots": [["ur5", color] for color in team]}),
                "map_rgb": rgb,
                "map_height": raster.encode_height(height, seen),
            }
        )
    return rows


def _rows_of(poses: Mapping[str, tuple[float, ...]]) -> NDArray[np.float64]:
    objects = np.full((len(ENTITIES), 7), np.nan)
    for name, (x, y, z, yaw) in poses.items():
        half = yaw / 2
        objects[ENTITIES.index(name)] = (x, y, z, math.cos(half), 0, 0, math.sin(half))
    return objects


def paint(
    poses: Mapping[str, tuple[float, ...]], team: tuple[str, ...], raster: Raster
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return the map of a scene: colors, and heights [m]."""
    rows, columns = np.mgrid[: raster.rows, : raster.columns]
    x = (columns + 0.5 - raster.columns / 2) * raster.cell_m
    y = (raster.rows / 2 - rows - 0.5) * raster.cell_m
    rgb = np.empty((raster.rows, raster.columns, 3), np.uint8)
    height = np.zeros((raster.rows, raster.columns))
    rgb[:] = _bytes(TABLE)
    # From low to high, so that what is on top is seen.
    for name, (px, py, z, yaw) in sorted(poses.items(), key=lambda item: item[1][2]):
        dx, dy = x - px, y - py
        along = np.cos(yaw) * dx + np.sin(yaw) * dy
        across = np.cos(yaw) * dy - np.sin(yaw) * dx
        if name == "stick":
            inside, top = (abs(along) < 0.2) & (abs(across) < 0.015), z + 0.015
            color = _bytes(STICK)
        elif name.endswith("_pad"):
            inside, top = np.hypot(dx, dy) < PAD_RADIUS_M, z + 0.004
            color = _bytes(OBJECT_COLORS[name.removesuffix("_pad")])
        else:
            inside = np.maximum(abs(along), abs(across)) < CUBE_HALF_M
            top = z + CUBE_HALF_M
            color = _bytes(OBJECT_COLORS[name.removesuffix("_cube")])
        rgb[inside], height[inside] = color, top
    for side, paint_name in zip((-1, 1), team, strict=True):
        inside = np.hypot(x - side * 0.6, y) < 0.08
        rgb[inside] = _bytes(OBJECT_COLORS[paint_name])
        height[inside] = 0.4
    # The corners are seen by no camera.
    unseen = abs(x) / x.max() + abs(y) / y.max() > 1.7
    rgb[unseen], height[unseen] = 0, 0.0
    return rgb, height


def _bytes(color: tuple[float, ...]) -> NDArray[np.uint8]:
    return np.round(255 * np.array(color[:3])).astype(np.uint8)
