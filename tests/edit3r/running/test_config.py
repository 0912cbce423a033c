import pytest

from edit3r.contract.errors import SettingsError
from edit3r.running.config import make_run_config
from edit3r.running.quality import PRESETS


def test_later_layers_win_and_settings_of_a_part_survive_a_renaming_layer():
    config = make_run_config(
        {"seed": 1, "editor": {"name": "recolor", "strength": 0.5}}, {"seed": 2}
    )
    assert config.seed == 2
    assert config.editor.name == "recolor" and config.editor.settings == {
        "strength": 0.5
    }


def test_a_part_may_be_given_by_name_alone_in_any_layer():
    assert make_run_config({"editor": "none"}).editor.name == "none"
    assert make_run_config(
        {"editor": {"a": 1}}, {"editor": "none"}
    ).editor.settings == {"a": 1}


def test_settings_without_a_name_keep_the_default_component():
    config = make_run_config({"reconstructor": {"weights": "x"}})
    assert config.reconstructor.name == "edit3r" and config.reconstructor.settings == {
        "weights": "x"
    }


def test_settings_of_the_segmenter_are_of_the_one_that_a_run_takes():
    chosen = make_run_config({"segmenter": {"pick": "grabcut"}}).segmenter
    assert (chosen.name, chosen.settings) == ("auto", {"pick": "grabcut"})


def test_a_tighter_limit_holds_over_the_number_of_a_preset_or_of_the_user():
    config = make_run_config({"gaussians": 5000}, {"max_gaussians": 100})
    first = config.all_refiners()[0]
    assert first.settings["gaussians"] == 5000
    assert first.settings["max_gaussians"] == 100
    whole = make_run_config({"gaussians": "all", "max_gaussians": 100})
    assert whole.all_refiners()[0].settings["max_gaussians"] == 100


@pytest.mark.parametrize(
    ("layer", "said"),
    [
        ({"seeds": 1}, "run.seeds: unknown setting. Did you mean 'seed'?"),
        ({"size": 1}, "run.size: input should be greater than or equal to 8, got 1"),
        ({"edit_views": "last"}, "run.edit_views"),
        ({"editor": {"strength": 1}}, "name it too, such as --editor recolor"),
        ({"larger": [1, "x"]}, "run.larger: input should be a valid integer"),
    ],
)
def test_a_wrong_key_or_value_is_one_sentence(layer, said):
    with pytest.raises(SettingsError) as error:
        make_run_config(layer)
    assert said in str(error.value)


@pytest.mark.parametrize("quality", [{}, *({"quality": name} for name in PRESETS)])
def test_naming_the_default_matcher_changes_no_setting(quality):
    named = make_run_config(quality, {"matcher": "classical"})
    assert named.matcher == make_run_config(quality).matcher
