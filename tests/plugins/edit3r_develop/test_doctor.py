"""`edit3r doctor`: everything that is wrong is a finding, never a traceback, and decides the exit
code.
"""

import pytest
import torch
from edit3r_develop import doctor
from edit3r_develop.doctor import Finding

from edit3r.cli.main import main
from edit3r.contract.component import Component, Offer
from edit3r.loading.load import LoadedPlugins, PluginFailure
from edit3r.loading.registry import Registry, default_registry
from edit3r.running.config import make_run_config

MODULE = "tests_of_doctor"


class NanRasterizer:
    def __init__(self, settings):
        pass

    def render(self, gaussians, cameras):
        from edit3r.contract.types import Rendering

        shape = (*cameras.c2w.shape[:2], 1, *cameras.image_size)
        return Rendering(
            torch.full(shape, torch.nan).expand(-1, -1, 3, -1, -1),
            torch.zeros(shape),
            torch.zeros(shape),
        )


class FailingRasterizer(NanRasterizer):
    def render(self, gaussians, cameras):
        raise RuntimeError("driver\nlost")


def registry(*offers, failures=()):
    return Registry(LoadedPlugins(tuple(offers), tuple(failures)))


def offer(kind, name, cls="NanRasterizer", plugin="mine", **more):
    return Offer(
        kind, Component(name, f"{MODULE}:{cls}", "a summary", **more), plugin, "1.0"
    )


@pytest.fixture(autouse=True)
def module(monkeypatch):
    import sys
    from types import ModuleType

    module = ModuleType(MODULE)
    module.NanRasterizer, module.FailingRasterizer = NanRasterizer, FailingRasterizer
    monkeypatch.setitem(sys.modules, MODULE, module)


def wrong(findings):
    return [finding.text for finding in findings if finding.ok is False]


def test_versions_name_edit3r_and_every_core_dependency():
    text = " ".join(finding.text for finding in doctor.versions())
    for name in ("edit3r 0", "plugin API 1", "Python 3", *doctor.CORE_MODULES.values()):
        assert name in text


def test_a_core_dependency_that_does_not_import_is_wrong(monkeypatch):
    monkeypatch.setattr(doctor, "CORE_MODULES", {"surely_not_there": "surely-not"})
    (text,) = wrong(doctor.versions())
    assert "reinstall it: pip install surely-not" in text


def test_the_memory_that_is_free_is_told_where_the_system_tells(monkeypatch):
    monkeypatch.setattr(doctor, "available_memory", lambda: 3 * 2**30)
    cpu = next(iter(doctor.devices())).text
    assert cpu.startswith("cpu: ") and "3.0 GiB of memory free" in cpu
    monkeypatch.setattr(doctor, "available_memory", lambda: None)
    assert "memory" not in next(iter(doctor.devices())).text


def test_a_cuda_build_without_a_gpu_is_named_with_the_way_out(monkeypatch):
    monkeypatch.setattr("torch.cuda.device_count", lambda: 0)
    monkeypatch.setattr("torch.backends.mps.is_available", lambda: False)
    for built_for, told in (("12.8", "--torch-backend=auto"), (None, "no GPU;")):
        monkeypatch.setattr("torch.version.cuda", built_for)
        assert told in list(doctor.devices())[-1].text


def test_failed_plugins_clashes_and_broken_components_are_wrong_a_missing_extra_is_not():
    here = registry(
        offer("rasterizer", "nan"),
        offer("editor", "twin", plugin="one"),
        offer("editor", "twin", plugin="two"),
        offer("editor", "needy", requires=("surely_not_there",)),
        failures=[PluginFailure("broken", "0.3", "it fell over")],
    )
    findings = list(doctor.plugins(here))
    text = "\n".join(wrong(findings))
    assert "broken 0.3: it fell over" in text
    assert "ask for one:twin or two:twin" in text
    assert "must be a subclass of edit3r.contract.interfaces.Rasterizer" in text
    assert "surely_not_there" not in text
    assert any(
        "needs surely_not_there" in finding.text
        for finding in findings
        if finding.ok is None
    )


def test_a_rasterizer_that_fails_or_draws_nan_is_wrong_and_the_others_are_tried():
    here = registry(
        offer("rasterizer", "nan"), offer("rasterizer", "lost", "FailingRasterizer")
    )
    assert wrong(doctor.rasterizers(here)) == [
        "lost: RuntimeError: driver lost",
        "nan: its image is not finite",
    ]


def test_a_tiny_job_that_fails_is_a_finding():
    config = make_run_config({"editor": "surely-not-there"})
    (text,) = wrong(doctor.tiny_job(default_registry(), config))
    assert "no editor named 'surely-not-there'" in text


@pytest.mark.slow
def test_the_tiny_job_runs_end_to_end_and_tells_its_time(monkeypatch):
    monkeypatch.setattr(doctor, "JOB_SIZE", 64)
    config = make_run_config(
        {"editor": "none", "reconstructor": "classical", "rasterizer": "torch"}
    )
    findings = list(doctor.tiny_job(default_registry(), config))
    assert wrong(findings) == []
    assert "Gaussians rendered and saved" in findings[-1].text


@pytest.mark.parametrize("ok, code", [(True, 0), (None, 0), (False, 1)])
def test_the_exit_code_is_1_only_when_something_is_wrong(ok, code, monkeypatch, capsys):
    monkeypatch.setattr(
        doctor, "examine", lambda *_: {"devices": [Finding("some", ok)]}
    )
    assert main(["doctor"]) == code
    assert (
        "1 wrong." if code else "Everything is in order."
    ) in capsys.readouterr().out
