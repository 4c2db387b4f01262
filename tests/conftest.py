import importlib.util
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import torch

if TYPE_CHECKING:
    from quaffure.body import BodyModel
    from quaffure.geometry import Surface

if importlib.util.find_spec("beartype") is not None:
    # Shapes are code: every annotated function checks its arrays while the tests run.
    from tests import shape_checks

    shape_checks.install()

SHARED_DATA = Path(__file__).parents[2] / "shared" / "data"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    no_data = pytest.mark.skip(reason=f"no {SHARED_DATA}: the real grooms and motion are not part of the project")
    no_cuda = pytest.mark.skip(reason="no CUDA device")
    for item in items:
        if "shared_data" in item.keywords and not SHARED_DATA.is_dir():
            item.add_marker(no_data)
        if "cuda" in item.keywords and not torch.cuda.is_available():
            item.add_marker(no_cuda)


@pytest.fixture(scope="module", autouse=True)
def _shapes_are_checked_in_every_file() -> None:
    if "tests.shape_checks" in sys.modules:
        sys.modules["tests.shape_checks"].restart()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    return SHARED_DATA


# Imports wait until after the hook above.
@pytest.fixture(scope="session")
def body() -> "BodyModel":
    from quaffure.body import load_body

    return load_body()


@pytest.fixture(scope="session")
def surface(body: "BodyModel") -> "Surface":
    """The body at rest."""
    return body.rest_surface


@pytest.fixture(scope="session")
def tiny_groom_file(body: "BodyModel", tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A groom that trains in no time."""
    from quaffure.io import write_groom
    from tests.training_runs import tiny_groom

    path = tmp_path_factory.mktemp("grooms") / "tiny.npz"
    write_groom(path, tiny_groom(body))
    return path


@pytest.fixture
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures of 64 pixels: a software rasteriser takes a second for a large one."""
    from quaffure.apps.render import pictures, video

    for module, name in ((pictures, "write_before_after"), (pictures, "write_picture"), (video, "write_video")):
        monkeypatch.setattr(module, name, partial(getattr(module, name), tile=64))
