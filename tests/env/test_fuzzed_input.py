"""Random values of any type are used or refused by a LemmaError, and soon."""

import contextlib
import copy
import math
import time
import warnings
from collections.abc import Callable
from dataclasses import fields
from functools import cache
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import lemma
from lemma.core.errors import LemmaError
from lemma.env.base_env import LemmaEnv
from lemma.env.config import EnvConfig
from lemma.env.learning.parallel_env import LemmaParallelEnv
from lemma.tasks.instance import Instance

LEVELS = ("control", "skill", "plan")
AGENTS = ("robot_0", "robot_1", "robot_2")
DATA = lemma.load_instance("stack", "test", 0).to_dict()

scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.complex_numbers(),
    st.text(max_size=8),
    st.binary(max_size=4),
)
nested = st.recursive(
    scalars,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.text(max_size=6), inner, max_size=4),
    ),
    max_leaves=30,
)
arrays = hnp.arrays(
    dtype=st.one_of(
        hnp.floating_dtypes(),
        hnp.integer_dtypes(),
        hnp.complex_number_dtypes(),
        hnp.boolean_dtypes(),
        hnp.unicode_string_dtypes(max_len=4),
    ),
    shape=st.one_of(
        st.sampled_from([(2, 8), (2, 3), (2, 7), (8,), (16,)]),
        hnp.array_shapes(max_dims=3, max_side=4),
    ),
)
junk = st.one_of(nested, arrays)
FUZZ = settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))


near = st.tuples(*[st.floats(-2.0, 2.0)] * 3)


@cache
def env_of(level: str) -> LemmaEnv:
    env = lemma.make("stack", level=level, split="test", index=0)
    env.reset()
    return env


@cache
def parallel() -> LemmaParallelEnv:
    env = lemma.parallel_env("stack", split="test", index=0)
    env.reset()
    return env


def make(data: st.DataObject) -> None:
    names = [field.name for field in fields(EnvConfig)]
    options = data.draw(st.dictionaries(st.sampled_from(names), junk, max_size=3))
    lemma.make(**{"task": "stack", **options})


def reset(data: st.DataObject) -> None:
    keys = st.one_of(st.sampled_from(["split", "index", "instance"]), st.text())
    options: Any = data.draw(st.one_of(junk, st.dictionaries(keys, junk, max_size=3)))
    seed: Any = data.draw(st.one_of(st.none(), scalars))
    try:
        env_of("control").reset(seed=seed, options=options)
    finally:
        env_of("control").reset(options={"index": 0})


def step(data: st.DataObject) -> None:
    env = env_of(data.draw(st.sampled_from(LEVELS)))
    if env.episode.elapsed_s > 0.0 or env.episode.is_over:
        env.reset(options={"index": 0})
    good = env.action_space.sample()
    action: Any = data.draw(junk)
    if isinstance(good, dict) and data.draw(st.booleans()):
        action = {**good, data.draw(st.sampled_from(list(good))): action}
    env.step(action)


def step_agents(data: st.DataObject) -> None:
    if not parallel().agents:
        parallel().reset()
    agents = st.dictionaries(st.sampled_from(AGENTS), junk)
    actions: Any = data.draw(st.one_of(junk, agents))
    parallel().step(actions)


def read_instance(data: st.DataObject) -> None:
    key, value = data.draw(st.sampled_from(list(DATA))), data.draw(nested)
    found = Instance.from_dict({**copy.deepcopy(DATA), key: value})
    assert Instance.from_dict(found.to_dict()) == found


def set_table(data: st.DataObject) -> None:
    moved = copy.deepcopy(DATA)
    poses = data.draw(st.lists(near, min_size=1, max_size=4))
    for placed, pose in zip(moved["objects"], poses, strict=False):
        placed[2:] = pose
    moved["robots"][1][2:] = data.draw(near)
    env = lemma.make("stack", split="test", index=0)
    env.reset(options={"instance": Instance.from_dict(moved)})
    for _ in range(3):
        env.step(env.action_space.sample())
    state = env.info()["state"]
    assert all(math.isfinite(x) for pose in state.values() for x in pose)


@pytest.mark.parametrize(
    "enter", [make, reset, step, step_agents, read_instance, set_table]
)
@FUZZ
@given(data=st.data())
def test_anything_is_used_or_refused_and_soon(
    enter: Callable[[st.DataObject], None], data: st.DataObject
) -> None:
    start = time.perf_counter()
    with contextlib.suppress(LemmaError), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        enter(data)
    assert time.perf_counter() - start < 30.0
