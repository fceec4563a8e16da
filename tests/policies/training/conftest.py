"""Painted data sets that trainings share."""

from pathlib import Path

import pytest
from painted_keyframes import write_painted


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("painted")
    return write_painted(folder, {"train": 10, "val": 4})


@pytest.fixture(scope="session")
def recovery(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Perturbed executions of the same episodes."""
    folder = tmp_path_factory.mktemp("perturbed")
    return write_painted(folder, {"train": 6, "val": 2}, perturbed=True)
