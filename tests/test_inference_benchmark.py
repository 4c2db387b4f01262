import json
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from quaffure import HairMaterial
from quaffure.apps.cli.main import main
from quaffure.benchmark import inference_benchmark
from quaffure.body import FEATURE_COUNT
from quaffure.model import NetworkConfig, build_network, save_network


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    config = NetworkConfig(pose_features=FEATURE_COUNT, texel_channels=8, strand_width=16)
    save_network(path, build_network(config), HairMaterial(), {})
    return path


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Measurements that are no better than rough."""
    timed = inference_benchmark._timed

    def once(run: Callable[[], object], repeats: int) -> tuple[float, float]:
        return timed(run, 1)

    monkeypatch.setattr(inference_benchmark, "_timed", once)
    monkeypatch.setattr(inference_benchmark, "_MATRIX", 256)


@pytest.mark.slow
@pytest.mark.usefixtures("brief")
def test_the_benchmark_measures_and_writes(
    weights: Path, tiny_groom_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "bench.json"
    arguments = ["--quick", "--groom", str(tiny_groom_file), "--weights", str(weights), "--out", str(out), "--json"]
    main(["benchmark", "inference", *arguments])
    written = json.loads(out.read_text())
    assert json.loads(capsys.readouterr().out) == written
    assert [timing["grooms"] for timing in written["grooms"]] == [1, 2, 4]
    assert written["grooms"][2]["strands"] == 4 * written["grooms"][0]["strands"]
    assert all(timing["seconds"] > 0 for timing in written["grooms"] + written["strands"])
    assert set(written["parts_cpu_milliseconds"]) == {
        "body",
        "texture",
        "strands_before",
        "strand_layers",
        "strands_after",
        "skin",
        "out_of_skin",
    }
    floor = written["floor"]
    slowest = max(
        floor["operations"] / floor["operations_per_second"], floor["bytes_moved"] / floor["bytes_per_second"]
    )
    assert floor["milliseconds"] == pytest.approx(1000 * slowest)
    assert written["machine"]["precision"] in ("bfloat16", "float32")


def test_bad_input_is_refused_before_the_work(
    weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for out in (tmp_path / "bench.txt", tmp_path / "nowhere" / "bench.json"):
        with pytest.raises(SystemExit) as stop:
            main(["benchmark", "inference", "--weights", str(weights), "--out", str(out)])
        assert stop.value.code == 2
        assert str(tmp_path) in capsys.readouterr().err
    paper = tmp_path / "paper.safetensors"
    save_network(paper, build_network(NetworkConfig(output="displacement")), HairMaterial(), {})
    with pytest.raises(SystemExit):
        main(["benchmark", "inference", "--weights", str(paper), "--out", str(tmp_path / "b.json")])
    assert "compiled to drape" in capsys.readouterr().err
