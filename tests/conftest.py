import gc
import importlib.util
import os
import sys
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numba
import pytest
import torch

from tests import groom_cache

if TYPE_CHECKING:
    from quaffure.body import BodyModel
    from quaffure.geometry import Surface
    from quaffure.hair import Groom, RegistrationReport
    from tests.scenes import Registered

if importlib.util.find_spec("beartype") is not None:
    # Shapes are code: every annotated function checks its arrays while the tests run.
    from tests import shape_checks

    shape_checks.install()

# Tests drape few strands: kernels on several threads wait for each other longer than they compute, on a busy machine
# ten times as long. Processes that tests start take the number over.
os.environ["OMP_NUM_THREADS"] = "1"
torch.set_num_threads(1)
groom_cache.install()
ALL_THREADS = (
    "cell_list", "cohesion", "comparison", "cpu_backend", "descent", "energies", "head_frame", "initial_shape",
    "mls_surface", "polyline", "projection", "rod", "rotation", "scalar_formulas", "signed_distance", "surroundings",
    "tiles", "triangle_grid",
)  # fmt: skip
"""Files that compare kernels with their twins, whose kernels run on as many threads as there are processors."""
assert all(Path(__file__).with_name(f"test_{name}.py").is_file() for name in ALL_THREADS)
SHARED_DATA = Path(__file__).parents[2] / "shared" / "data"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    no_data = pytest.mark.skip(reason=f"no {SHARED_DATA}: the real grooms and motion are not part of the project")
    no_cuda = pytest.mark.skip(reason="no CUDA device")
    for item in items:
        if "shared_data" in item.keywords and not SHARED_DATA.is_dir():
            item.add_marker(no_data)
        if "cuda" in item.keywords and not torch.cuda.is_available():
            item.add_marker(no_cuda)


def pytest_collection_finish() -> None:
    """The hundred thousands of objects that imports have left are no garbage: collections need not visit them."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="module", autouse=True)
def _shapes_are_checked_in_every_file() -> None:
    if "tests.shape_checks" in sys.modules:
        sys.modules["tests.shape_checks"].restart()


@pytest.fixture(scope="module", autouse=True)
def _threads_of_kernels(request: pytest.FixtureRequest) -> None:
    has_all = Path(request.module.__file__).stem.removeprefix("test_") in ALL_THREADS
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS if has_all else 1)


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
def registered(shared_data: Path) -> "Registered":
    """By names of files of the shared data that belong together: a copy of their groom, registered once, its report."""
    from quaffure.body import load_body
    from quaffure.hair import concatenate_strands, register_groom
    from quaffure.io import read_head
    from quaffure.io.read_strands import read_strands

    @cache
    def once(*files: str, head: str) -> "tuple[Groom, RegistrationReport]":
        parts = [read_strands(shared_data / file) for file in files]
        strands = parts[0] if len(parts) == 1 else concatenate_strands(parts)
        mesh = read_head(shared_data / head) if head else None
        return register_groom(strands, load_body(), Path(files[0]).stem, mesh)

    def copy_of(*files: str, head: str = "") -> "tuple[Groom, RegistrationReport]":
        groom, report = once(*files, head=head)
        return groom.select(torch.arange(len(groom))), report

    return copy_of


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
