import pytest
from edit3r_training.job import prepare

from edit3r.contract.errors import InputError, SettingsError, UnknownComponentError
from edit3r.contract.settings import of_file
from edit3r.loading.registry import default_registry

SMALL = {
    "trainer": {"name": "recolor", "steps": 3},
    "reconstructor": {"name": "edit3r", "weights": "untrained"},
    "rasterizer": "torch",
    "train_data": {"name": "procedural", "scenes": 2, "image_size": 16},
    "losses": {"mse": {"weight": 0.5, "cell": 2}},
    "out": "somewhere",
}


def test_a_configuration_builds_every_component():
    trainer, job = prepare(SMALL, default_registry())
    weight, loss = job.losses["mse"]
    assert trainer.settings.steps == 3
    assert weight == 0.5 and loss.settings.cell == 2
    assert len(job.train_data) == 2
    assert job.validation_data is None
    assert job.config["trainer"]["settings"]["steps"] == 3


def test_an_unknown_key_is_named():
    with pytest.raises(SettingsError, match=r"training\.los.*losses"):
        prepare(SMALL | {"los": {}}, default_registry())


def test_an_unknown_dataset_lists_those_there_are():
    with pytest.raises(UnknownComponentError, match="procedural"):
        prepare(SMALL | {"train_data": "proceduril"}, default_registry())


def test_a_weight_that_is_no_number_is_refused():
    with pytest.raises(SettingsError, match=r"losses\.mse\.weight"):
        prepare(SMALL | {"losses": {"mse": {"weight": "much"}}}, default_registry())


@pytest.mark.parametrize("file", ["last.pt", "log.jsonl", "best/weights.safetensors"])
def test_a_training_is_not_overwritten_unless_asked_to(tmp_path, file):
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).touch()
    values = SMALL | {"out": str(tmp_path)}
    resume = "--resume.*" if file == "last.pt" else ""
    said = rf"holds a training already.*{resume}--out.*--overwrite"
    with pytest.raises(InputError, match=said):
        prepare(values, default_registry())
    assert prepare(values, default_registry(), overwrite=True)[1].resume is False
    assert prepare(values, default_registry(), resume=True)[1].resume is True


@pytest.mark.parametrize("out", ["/tmp/x", "../x", "a/../../x", "."])
def test_a_strangers_file_says_no_place_outside_of_the_folder(tmp_path, out):
    values = SMALL | of_file({"out": out})
    with pytest.raises(InputError, match=r"training.out.*--out.*--trust-config"):
        prepare(values, default_registry())


def test_an_output_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="--out must be a folder"):
        prepare(SMALL | {"out": str(tmp_path / "file")}, default_registry())
