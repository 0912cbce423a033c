"""`edit3r train` keeps a folder to one training at a time."""

from types import SimpleNamespace

import pytest
from edit3r_training.job import prepare

import edit3r
from edit3r.cli.main import main
from edit3r.contract.errors import SettingsError
from edit3r.kit.command.results import alone_in


def test_a_second_training_does_not_write_into_the_same_folder(
    tmp_path, monkeypatch, capsys
):
    begun = []

    def train(job):
        begun.append(job)
        (job.out / "best").mkdir()
        (job.out / "best/weights").touch()
        return job.out / "best"

    trainer = SimpleNamespace(train=train)
    job = SimpleNamespace(out=tmp_path)
    monkeypatch.setattr("edit3r_training.job.prepare", lambda *_, **__: (trainer, job))
    command = ["train", "training/noposplat-tiny"]
    with alone_in(tmp_path):
        assert main(command) == 2
    assert not begun
    assert "another run writes its results there" in capsys.readouterr().err
    assert main(command) == 0 and begun == [job]


@pytest.mark.parametrize("key", ["losses.mse", "train_data", "validation_data"])
def test_a_wrong_setting_is_called_by_its_key(key, tmp_path):
    wrong = {"losses": {"mse": {"sharp": 3}}} if "." in key else {}
    data = {"name": "procedural"}
    given = {"reconstructor": {"name": "edit3r", "weights": "untrained"}, **wrong}
    given |= {"train_data": data, "validation_data": data, "out": str(tmp_path / "out")}
    if not wrong:
        given[key] = {**data, "sharp": 3}
    with pytest.raises(SettingsError, match=f"^{key}.sharp: unknown setting"):
        prepare(given, edit3r.default_registry())
