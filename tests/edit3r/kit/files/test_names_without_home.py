"""Users without a home folder: nothing fails, nothing is left in the current folder."""

import os

import pytest
from numba.core import caching

from edit3r.cli.main import main
from edit3r.contract.errors import InputError
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.weights import Weights
from edit3r.kit.compute.compiling import compiled
from edit3r.kit.files.atomic import atomic_folder
from edit3r.kit.files.names import expanded, user_cache
from edit3r.kit.weights.find import at_hand, folder

SOME = Weights("some", "tests", 1, "MIT", "yes", "hub:a/b", files=(("x", ""),))
NO_HOME = {
    "nobody in passwd": {},
    "HOME=": {"HOME": ""},
    "HOME=~": {"HOME": "~"},
    "HOME=x": {"HOME": "x"},
    "XDG_CACHE_HOME=x": {"XDG_CACHE_HOME": "x"},
    "NUMBA_CACHE_DIR=x": {"NUMBA_CACHE_DIR": "x"},
    "all of them": {"HOME": "./y", "XDG_CACHE_HOME": "x", "NUMBA_CACHE_DIR": "x"},
    "HF_HOME=x": {"HF_HOME": "x"},
}


@pytest.fixture(params=NO_HOME.values(), ids=NO_HOME)
def without_home(request, tmp_path, monkeypatch):
    pwd = pytest.importorskip("pwd", reason="no users of that kind here")

    def nobody(_):
        raise KeyError

    monkeypatch.setattr(pwd, "getpwuid", nobody)
    for name in (
        "HOME",
        "XDG_CACHE_HOME",
        "NUMBA_CACHE_DIR",
        "HF_HOME",
        "HF_HUB_CACHE",
    ):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.delenv("EDIT3R_WEIGHTS", raising=False)
    for name, value in request.param.items():
        monkeypatch.setenv(name, value)
    cache = request.param.get("NUMBA_CACHE_DIR", "")
    monkeypatch.setattr(caching.config, "CACHE_DIR", cache)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_weights_are_not_there_and_fetching_says_what_to_name(without_home, capsys):
    assert at_hand(SOME) is None
    assert main(["weights", "list"]) == 0
    if user_cache() is None:
        assert "EDIT3R_WEIGHTS" in capsys.readouterr().out
        with pytest.raises(InputError, match="EDIT3R_WEIGHTS"):
            folder()
    assert folder(without_home / "w") == without_home / "w"
    assert not list(without_home.iterdir())


def test_kernels_are_compiled_and_nothing_is_left_behind(without_home, monkeypatch):
    monkeypatch.setattr(
        caching.CacheImpl,
        "_locator_classes",
        [caching.UserProvidedCacheLocator, caching.UserWideCacheLocator],
    )
    with collecting(Report()):
        assert compiled()(lambda value: value + 1)(1) == 2
    inside = [path for path in without_home.iterdir() if path.name != ".cache"]
    assert not inside


def test_a_path_below_the_home_folder_is_one_sentence(without_home):
    if os.path.expanduser("~") == "~":
        with pytest.raises(InputError, match="no home folder"):
            expanded("~/x")
        with pytest.raises(InputError, match="no home folder"), atomic_folder("~/x"):
            pass
