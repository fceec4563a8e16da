"""Random values of any type are used or refused by a LemmaError, and soon."""

import contextlib
import time
import warnings
from dataclasses import fields
from functools import cache
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import lemma
from lemma.core.errors import LemmaError
from lemma.env.base_env import LemmaEnv
from lemma.env.config import EnvConfig
from lemma.env.learning.parallel_env import LemmaParallelEnv

LEVELS = ("control", "skill", "plan")
AGENTS = ("robot_0", "robot_1", "robot_2")

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


def assert_bounded(call: Any) -> None:
    """A call works, or is refused by an error of ours, and soon."""
    start = time.perf_counter()
    with contextlib.suppress(LemmaError), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        call()
    assert time.perf_counter() - start < 30.0


@FUZZ
@given(data=st.data())
def test_make_takes_anything_or_refuses_it(data: st.DataObject) -> None:
    names = [field.name for field in fields(EnvConfig)]
    options = data.draw(st.dictionaries(st.sampled_from(names), junk, max_size=3))
    assert_bounded(lambda: lemma.make(**{"task": "stack", **options}))


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


@FUZZ
@given(data=st.data())
def test_reset_takes_anything_or_refuses_it(data: st.DataObject) -> None:
    env = env_of("control")
    keys = st.one_of(st.sampled_from(["split", "index", "instance"]), st.text())
    options: Any = data.draw(st.one_of(junk, st.dictionaries(keys, junk, max_size=3)))
    seed: Any = data.draw(st.one_of(st.none(), scalars))
    assert_bounded(lambda: env.reset(seed=seed, options=options))
    env.reset(options={"index": 0})


@FUZZ
@given(data=st.data())
def test_step_takes_anything_or_refuses_it(data: st.DataObject) -> None:
    for env in map(env_of, LEVELS):
        good = env.action_space.sample()
        action: Any = data.draw(junk)
        if isinstance(good, dict) and data.draw(st.booleans()):
            action = {**good, data.draw(st.sampled_from(list(good))): action}
        before = env.episode.elapsed_s
        assert_bounded(lambda env=env, action=action: env.step(action))
        if env.episode.elapsed_s > before or env.episode.is_over:
            env.reset(options={"index": 0})


@FUZZ
@given(actions=st.one_of(junk, st.dictionaries(st.sampled_from(AGENTS), junk)))
def test_agents_take_anything_or_refuse_it(actions: Any) -> None:
    assert_bounded(lambda: parallel().step(actions))
    if not parallel().agents:
        parallel().reset()
