"""The shipped recipes of the paper's model: the tiny ones from data to image, the full ones setting
by setting.
"""

import json
import re
import shlex
from pathlib import Path

import pytest
import torch
import yaml
from edit3r_training.asymmetric_inputs import REGIMES
from edit3r_training.job import TrainingConfig, prepare
from edit3r_training.loop import parameter_groups
from edit3r_training.processes import Processes
from edit3r_training.recolor_trainer import RecolorRecipe

from edit3r.cli.main import main
from edit3r.contract.settings import PartChoice, make_settings, merge
from edit3r.kit.files.configs import find_config, parse_assignments, read_yaml
from edit3r.kit.photos.images import save_image
from edit3r.loading.registry import build, default_registry

pytestmark = pytest.mark.slow

QUICK = "trainer.steps=2 trainer.batch=1 trainer.validate_every=2 trainer.log_every=1"
DATA = "train_data.scenes=2 train_data.textures=8"
DATA += " validation_data.scenes=1 validation_data.textures=8 rasterizer=torch"
SMALL = {
    "backbone": {"width": 32, "depth": 1, "heads": 2, "decoder_width": 32}
    | {"decoder_depth": 4, "decoder_heads": 2},
    "head": {"feature_width": 8, "point_width": 8, "layer_widths": [8, 8, 8, 8]},
}
MADE_UP = {"name": "procedural", "scenes": 2, "textures": 8}


SMALL_ABLATIONS = sorted(
    f"ablations/{file.stem}"
    for file in find_config("training/ablations/full").parent.glob("*")
)


def _options(*assignments: str) -> list[str]:
    return [text for assignment in assignments for text in ("--set", assignment)]


def _trained(recipe: str, out: Path, *assignments: str) -> Path:
    """The folder `best` of a tiny recipe, two steps long."""
    quick = _options(*QUICK.split(), *DATA.split(), *assignments)
    assert main(["train", f"training/{recipe}", "--out", str(out), *quick]) == 0
    return out / "best"


@pytest.fixture(scope="module")
def photos(tmp_path_factory) -> list[str]:
    """Two views of a made-up scene as files."""
    folder = tmp_path_factory.mktemp("photos")
    drawn = {"image_size": 64, "scenes": 1, "seed": 5, "textures": 8}
    sample = build("dataset", "procedural", **drawn)[0]
    paths = [folder / f"{view}.png" for view in range(2)]
    for path, image in zip(paths, sample.context):
        save_image(image, path)
    return [str(path) for path in paths]


@pytest.fixture(scope="module")
def efficientnet():
    pytest.importorskip("efficientnet_lite_pytorch", reason="the extra train is needed")


@pytest.fixture(scope="module")
def stages(tmp_path_factory, efficientnet) -> tuple[Path, Path]:
    """The folders `best` of both tiny stages, the second begun from and held to the first."""
    root = tmp_path_factory.mktemp("stages")
    first = _trained("noposplat-tiny", root / "first")
    begun = (
        f"reconstructor.weights={first}",
        "reference.name=noposplat",
        f"reference.weights={first}",
        "trainer.pretrained=[backbone.patch_embed, backbone.encoder, backbone.decoder, "
        "head.centres]",
    )
    return first, _trained("edit3r-paper-tiny", root / "second", *begun)


def test_the_tiny_recipes_lead_from_data_to_images(stages, photos, tmp_path):
    for name, best in zip(("first", "second"), stages):
        out = tmp_path / name
        how = f"--editor none --recon noposplat --out {out} --quiet".split()
        few = ("frames=2", "outputs=scene,images", f"reconstructor.weights={best}")
        assert main(["run", *photos, *how, *_options(*few)]) == 0
        assert (out / "scene.ply").is_file()


def test_the_generative_recipe_trains(tmp_path, efficientnet):
    _trained("edit3r-generative-tiny", tmp_path / "out")
    written = (tmp_path / "out/log.jsonl").read_text()
    assert all(f'"{name}"' in written for name in ("uptake", "leak", "novel"))


def test_the_second_stage_begins_from_the_first_and_logs_every_term(stages):
    second = stages[1].parent
    lines = [
        json.loads(line) for line in (second / "log.jsonl").read_text().splitlines()
    ]
    assert {"mse", "perceptual", "center", "geometry"} <= set(lines[0])
    first = build("reconstructor", "noposplat", weights=str(stages[0])).network
    moved = build("reconstructor", "noposplat", weights=str(stages[1])).network
    gaps = [(a - b).abs().max() for a, b in zip(first.parameters(), moved.parameters())]
    assert 0 < max(gaps) < 0.01  # two small steps from there, not another random start


def test_a_reconstructor_of_a_plugin_file_is_trained_and_used(photos, tmp_path):
    """`--plugin` for the training, its setting `weights` for the result."""
    plugin = Path(__file__).parents[3] / "examples/learned.py"
    short = {"steps": 1, "batch": 1, "unit": "baseline", "warmup": 1, "lr": 0.01}
    config = {
        "trainer": {"name": "recolor", **short},
        "reconstructor": {"name": "learned", "size": 32},
        "rasterizer": "torch",
        "train_data": {**MADE_UP, "image_size": 32},
    }
    (tmp_path / "learned.yaml").write_text(yaml.safe_dump(config))
    train = ["train", str(tmp_path / "learned.yaml"), "--plugin", str(plugin)]
    assert main([*train, "--out", str(tmp_path / "out")]) == 0
    weights = str(tmp_path / "out/best")
    how = f"--recon learned --frames 2 --plugin {plugin} --quiet --editor none"
    command = ["run", *photos, *how.split(), "--out", str(tmp_path / "scene")]
    assert main([*command, *_options(f"reconstructor.weights={weights}")]) == 0
    registry = default_registry((str(plugin),))
    start, trained = (
        registry.build("reconstructor", "learned", weights=given).network
        for given in (None, weights)
    )
    assert not torch.equal(start["head"].out.weight, trained["head"].out.weight)


FULL = ("noposplat", "edit3r-paper")
TINY = ("noposplat-tiny", "edit3r-paper-tiny", "edit3r-generative-tiny")


@pytest.mark.parametrize("name", [*FULL, *TINY, *SMALL_ABLATIONS])
def test_every_setting_of_a_recipe_is_known(name):
    registry = default_registry()
    config = make_settings(
        TrainingConfig, read_yaml(find_config(f"training/{name}")), "training"
    )

    def check(kind: str, choice: PartChoice) -> None:
        given = dict(choice.settings)
        if "weights" in given:
            given["weights"] = "untrained"  # the files come from the stage before
        offer = registry.find(kind, choice.name)
        if registry.missing(offer):  # an extra: the part cannot be imported here
            return
        settings = make_settings(registry.settings_class(offer), given, kind)
        for part in ("backbone", "head"):
            if kind == "reconstructor":
                check(part, getattr(settings, part))

    check("trainer", config.trainer)
    for choice in filter(None, (config.reconstructor, config.reference)):
        check("reconstructor", choice)
    for choice in (config.train_data, config.validation_data):
        check("dataset", choice)
    check("rasterizer", config.rasterizer)
    for loss, given in config.losses.items():
        own = {key: value for key, value in given.items() if key != "weight"}
        check("loss", PartChoice(name=loss, settings=own))


def _small(values: dict, out: Path) -> dict:
    """A recipe but for sizes, data, device, and losses that need weights from elsewhere."""
    losses = {k: v for k, v in values["losses"].items() if k not in ("clip", "lpips")}
    data = {**MADE_UP, "image_size": 32, "targets": 1}
    network = {"weights": "random", **SMALL}
    parts = {"reconstructor", "reference"} & {*values}
    short = {"trainer": {"steps": 1, "batch": 1, "device": "cpu"}}
    return merge(values, short | dict.fromkeys(parts, network)) | {
        "losses": losses,
        "train_data": data,
        "validation_data": data,
        "rasterizer": "torch",
        "out": str(out),
    }


@pytest.mark.parametrize("name", FULL)
def test_a_full_recipe_trains_a_small_network(name, tmp_path):
    """As it is shipped but for sizes, data, device, and losses that need weights from elsewhere."""
    values = read_yaml(find_config(f"training/{name}"))
    trainer, job = prepare(_small(values, tmp_path), default_registry())
    best = trainer.train(job)
    assert (best / "weights.safetensors").is_file()
    groups = parameter_groups(job.reconstructor.network, trainer.settings)
    assert [rate for rate, _ in groups] == [1.0, 0.1]
    fresh = {id(p) for p in groups[0][1]}
    named = dict(job.reconstructor.network.named_parameters())
    begins = {".".join(k.split(".")[:2]) for k, p in named.items() if id(p) in fresh}
    # what MASt3R does not have
    assert begins == {"backbone.intrinsics_embed", "head.attributes"}


ABLATION = re.compile(
    r"^#   ([a-z0-9-]+): +(?:edit3r train training/edit3r-paper|\.\.\.)(.*)$", re.M
)
ABLATIONS = dict(ABLATION.findall(find_config("bench/training-ablation").read_text()))


@pytest.mark.parametrize("name", ABLATIONS)
def test_the_documented_command_of_an_ablation_can_be_trained(name, tmp_path):
    """As written in the benchmark's configuration; one, without a whole loss, is trained too."""
    given = [word for word in shlex.split(ABLATIONS[name]) if word != "--set"]
    values = merge(
        read_yaml(find_config("training/edit3r-paper")), parse_assignments(given)
    )
    values = merge(values, {"trainer": {"accumulate": 1}})
    trainer, job = prepare(_small(values, tmp_path), default_registry())
    shares = trainer.settings.regimes
    drawn = {regime for regime in REGIMES if getattr(shares, regime) > 0}
    expected = "viewwise" if name == "without-recolor" else "reference"
    assert drawn == {expected}
    if name == "without-3d-loss":
        assert (trainer.train(job) / "weights.safetensors").is_file()


def test_the_first_stage_is_regularised_as_published():
    """NoPoSplat: dropout before the attributes' last layer, and no averaged weights."""
    values = read_yaml(find_config("training/noposplat"))
    assert values["reconstructor"]["head"]["dropout"] == 0.1
    assert values["trainer"]["average"] == 0


def test_half_precision_leaves_weights_and_losses_in_float32(tmp_path):
    values = read_yaml(find_config("training/edit3r-paper-tiny"))
    few = {"scenes": 1, "textures": 8}
    values = merge(values, {"reconstructor": SMALL, "train_data": few})
    values |= {"losses": {"mse": {}, "center": {}}, "out": str(tmp_path)}
    totals = {}
    for precision in ("float32", "bfloat16"):
        given = {"trainer": {"batch": 1, "precision": precision}, "rasterizer": "torch"}
        given = merge(values, given)
        trainer, job = prepare(given, default_registry(), overwrite=True)
        recipe = RecolorRecipe(trainer.settings, job)
        recipe.network.train()
        recipe.begin()
        totals[precision] = recipe.loss(0, Processes()).total
        totals[precision].backward()
        gradients = [p.grad for p in recipe.network.parameters()]
        assert all(g.dtype == torch.float32 and g.isfinite().all() for g in gradients)
    assert totals["bfloat16"].dtype == torch.float32
    assert 0 < abs(totals["bfloat16"] - totals["float32"]) < 0.05 * totals["float32"]
