"""Every way to set something of a writer reaches a stranger's, and wrong ones are told."""

import sys
from pathlib import Path

import pytest
import yaml
from edit3r_develop.new_plugin import new_package
from PIL import Image

from edit3r.cli.main import main
from edit3r.contract.errors import SettingsError
from edit3r.kit.photos.images import packaged_pair
from edit3r.running import make_run_config

FLAT = Path(__file__).parents[1] / "flat_scene.py"
PARTS = f"--editor none --recon flat --rasterizer torch --plugin {FLAT}"
SMALL = "--size 24 --refine 0 --gaussians all --frames 3 --quiet --out out"


@pytest.fixture
def gif(tmp_path, monkeypatch):
    """The package that `edit3r new-plugin writer gif` makes, beside two photos."""
    monkeypatch.chdir(tmp_path)
    for name, photo in zip("ab", packaged_pair()[0]):
        Image.open(photo).resize((48, 32)).save(f"{name}.png")
    yield new_package("writer", "gif", tmp_path) / "edit3r_gif"
    for module in [name for name in sys.modules if name.startswith("edit3r_gif")]:
        del sys.modules[module]


def drawn(file):
    """Width, and how many different frames."""
    with Image.open(file) as picture:
        frames = set()
        for index in range(picture.n_frames):
            picture.seek(index)
            frames.add(picture.convert("RGB").tobytes())
        return picture.width, len(frames)


def test_all_ways_to_set_a_width_reach_the_writer(gif):
    run = f"run a.png b.png {PARTS} {SMALL} --plugin {gif}"
    by_flag = f"{run} --outputs scene,images,gif --set writer.gif.width=40"
    assert main(by_flag.split()) == 0
    assert drawn("out/flight.gif")[0] == 40
    assert drawn("out/flight.gif")[1] > 1, "it shows a flight"

    asked = {"outputs": ["scene", "images", {"name": "gif", "width": 56}]}
    Path("asked.yaml").write_text(yaml.safe_dump(asked))
    assert main(f"{run} --overwrite --config asked.yaml".split()) == 0
    assert drawn("out/flight.gif")[0] == 56

    export = f"export out --to gif --plugin {gif} --quiet --out e.gif"
    assert main(f"{export} --set writer.gif.width=72".split()) == 0
    assert drawn("e.gif")[0] == 72


def test_a_flag_is_over_what_stands_in_the_list():
    layers = (
        {"outputs": [{"name": "video", "fps": 5}]},
        {"writer": {"video": {"fps": 7}}},
    )
    config = make_run_config(*layers)
    assert config.outputs == ("video",)
    assert config.writer_choice("video").settings == {"fps": 7}


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("writer.video.fps=30", "add it to outputs or export"),
        ("writer.sheet.width=3", "writer.sheet.width: unknown setting"),
    ],
)
def test_what_no_writer_takes_is_refused_before_a_run(gif, capsys, given, told):
    run = f"run a.png b.png {PARTS} {SMALL} --outputs scene,images,sheet --set {given}"
    assert main(run.split()) == 2
    assert told in capsys.readouterr().err
    assert not Path("out").exists()


@pytest.mark.parametrize("given", ["fps=3", "writer.video.fps=3", "writer.sheet=3"])
def test_an_export_takes_settings_of_its_own_writers_alone(given):
    from edit3r_outputs.export import _choices

    with pytest.raises(SettingsError, match=r"expected writer\.NAME"):
        _choices(["sheet"], [given])
