import json
from pathlib import Path
from unittest import mock

import pytest
import torch

from quaffure import HairMaterial
from quaffure.apps.cli.main import main
from quaffure.baselines import PosedDraper
from quaffure.benchmark import run_benchmark
from quaffure.benchmark.solver_benchmark import Budget, Case, budgets
from quaffure.body import load_body
from quaffure.energies import Terms
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene


def bench(out: Path, *more: str) -> None:
    main(["benchmark", "solvers", "--quick", "--strands", "24", "--out", str(out), *more])


def refused(capfd: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as stop:
        main(["benchmark", "solvers", *arguments])
    errors = capfd.readouterr().err
    assert stop.value.code == 2
    assert errors.count("\n") == 1
    return errors


def test_benchmark_writes_prints_and_plots(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    out = tmp_path / "bench.json"
    bench(out, "--json")
    written = json.loads(out.read_text())
    assert json.loads(capfd.readouterr().out) == written
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bench.json", "bench.png"]
    assert (tmp_path / "bench.png").read_bytes().startswith(b"\x89PNG")
    runs = written["runs"]
    assert [run["solver"] for run in runs] == [budget.solver for budget in budgets(quick=True)]
    assert min(run["excess_energy"] for run in runs) == 0
    energy = {(run["solver"], run["effort"]): run["energy"] for run in runs}
    assert energy["xpbd", 30] < energy["xpbd", 10] < energy["posed", 0]
    assert energy["strand_newton", 12] <= energy["strand_newton", 8] < energy["posed", 0]
    assert energy["lbfgs", 60] < energy["lbfgs", 20] < energy["posed", 0]
    for run in runs:
        assert run["seconds"] > 0
        assert run["cpu_seconds"] > 0
        if run["solver"] == "posed":
            assert run["iterations"] is None
        else:
            assert run["iterations"] >= run["effort"]
        on_directions = run["solver"] in ("strand_newton", "adam", "lbfgs", "posed")
        assert (run["length_error_percent"] < 1e-3) == on_directions, run["solver"]


def test_the_papers_model_is_measured_too(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    bench(tmp_path / "bench.json", "--elastic", "modified_cosserat", "--solver", "xpbd", "--json")
    assert [run["effort"] for run in json.loads(capfd.readouterr().out)["runs"]] == [10, 30]
    out = str(tmp_path / "none.json")
    assert "strand_newton" in refused(
        capfd, "--out", out, "--elastic", "modified_cosserat", "--solver", "strand_newton"
    )
    assert "rod or modified_cosserat" in refused(capfd, "--out", out, "--elastic", "jelly")


def test_a_table_without_a_plot_where_matplotlib_is_missing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with mock.patch("quaffure.apps.cli.benchmark.is_installed", return_value=False):
        bench(tmp_path / "bench.json", "--solver", "posed", "--frames", "3:5", "--motion", "nod")
    printed = capfd.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["bench.json"]
    assert "quaffure[docs]" in printed.replace("\n", "")
    assert "long_straight, nod 3:5 #1; energies in m g L per vertex" in printed.replace("\n", " ")


def test_a_part_of_a_run_is_extrapolated_and_the_best_has_no_excess() -> None:
    def posed(material: HairMaterial, terms: Terms) -> PosedDraper:
        return PosedDraper(material)

    ticks = iter(range(100))
    parts = [Budget("posed", 1, posed), Budget("posed", 2, posed, share=0.25)]
    body = load_body()
    groom = make_groom("long_straight", body).select(torch.arange(3))
    case = Case("rest", Scene(groom, BodyBatch(body, torch.zeros(1, 81), torch.zeros(1, 10))))
    with (
        mock.patch("quaffure.benchmark.solver_benchmark._compile"),
        mock.patch("quaffure.benchmark.solver_benchmark.time.perf_counter", side_effect=lambda: next(ticks)),
    ):
        whole, part = run_benchmark([case], parts)
    assert (whole.seconds, part.seconds, part.share) == (1, 4, 0.25)
    assert whole.excess_energy == part.excess_energy == 0


def test_mistakes_are_printed_in_one_line_before_the_work(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "bench.json")
    assert "'magic'" in refused(capfd, "--out", out, "--solver", "magic")
    assert "'magic'" in refused(capfd, "--out", out, "--solver", "magic", "--quick")
    assert "--solver with these options" in refused(capfd, "--out", out, "--solver", "xpbd_paper", "--quick")
    assert "missing.obj" in refused(capfd, "--out", out, "--groom", "any.tfx", "--head", "missing.obj")
    assert "suffix .json" in refused(capfd, "--out", str(tmp_path / "bench.txt"))
    assert "existing folder" in refused(capfd, "--out", str(tmp_path / "none" / "bench.json"))
    assert "--strands" in refused(capfd, "--out", out, "--strands", "0")
    assert not list(tmp_path.iterdir())
