"""Plugins in tests: loaded for one test alone."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from lemma.audit.attack import ATTACKS
from lemma.core import plugins
from lemma.core.registry import Registry
from lemma.motion.skills import SKILLS
from lemma.planning.primitives import PRIMITIVES
from lemma.robots.ur.arms import ARMS
from lemma.scene.objects.kind import OBJECT_KINDS
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.tasks import subtask
from lemma.tasks.suite import TASKS

EXAMPLES = Path(__file__).parents[2] / "examples"
_REGISTRIES: tuple[Registry[Any], ...] = (
    *(TASKS, ARMS, PRIMITIVES, SKILLS),
    *(OBJECT_KINDS, OBJECT_COLORS, ATTACKS),
)


@contextmanager
def loaded(*names: object) -> Iterator[None]:
    """Load plugins, and forget them and what they have registered."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(plugins.ENVIRONMENT, "")
        patch.setattr(plugins, "_loaded", {})
        patch.setattr(sys, "path", list(sys.path))
        patch.setattr(subtask, "_added", dict(subtask._added))
        for registry in _REGISTRIES:
            for field in ("_records", "_added_by"):
                patch.setattr(registry, field, dict(getattr(registry, field)))
        plugins.load_plugins(map(str, names))
        yield
