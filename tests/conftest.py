"""What tests of several rooms share."""

import multiprocessing
import os
import sys

# Several processes share the cores, and waiting threads cost a third of the suite's time. Tests of
# threads set their number themselves. Torch reads this when it is imported.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")
# What the suite says must not depend on weights that this machine happens to hold.
os.environ["EDIT3R_WEIGHTS"] = os.path.join(os.path.dirname(__file__), "no-weights")

import pytest
import torch
from hypothesis import settings

# A test's time depends on what else the machine does; speed is measured in benchmarks/.
settings.register_profile("edit3r", deadline=None)
settings.load_profile("edit3r")


def _changes(folder, event, arguments):
    """Whether an audit event of Python is a change of `folder` on the disk."""
    if event == "ctypes.call_function":
        return True
    if not (arguments and str(folder) in str(arguments[0])):
        return False
    if event == "open":
        return bool(arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
    return event.startswith(("os.", "shutil."))


@pytest.fixture
def killed_at():
    """Call `act` in a process that ends, without a word, before its `step`-th change of `folder`.

    Returns False where it ended by itself, with fewer changes.
    """

    if not hasattr(os, "fork"):
        pytest.skip("needs fork, which Windows does not have")

    def run(step, folder, act):
        child = os.fork()
        if child:
            return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
        left = step

        def count(event, arguments):
            nonlocal left
            left -= _changes(folder, event, arguments)
            if left < 0:
                os._exit(9)

        torch.set_num_threads(1)
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        sys.addaudithook(count)
        try:
            act()
        finally:
            os._exit(0)

    return run


@pytest.fixture
def forked_workers(monkeypatch):
    """Start worker processes as forks of this one, so that none has to import all anew.

    That processes of their own start, as users' do, is asked in `kit/test_workers.py`. Without
    xdist they do here too: torch may have begun threads, with which a fork can hang.
    """
    if "PYTEST_XDIST_WORKER" in os.environ and hasattr(os, "fork"):
        fork = multiprocessing.get_context("fork")
        monkeypatch.setattr(multiprocessing, "get_context", lambda method: fork)


MANY_IMPORTS = 30  # modules


def pytest_addoption(parser):
    parser.addoption(
        "--quick-limit",
        type=float,
        metavar="SECONDS",
        help="fail a test that is not marked slow and takes more CPU seconds, such as 1",
    )


def pytest_ignore_collect(collection_path, config):
    """Import no file without slow tests where only those are asked for: each process would."""
    only_slow = config.option.markexpr == "slow" and collection_path.suffix == ".py"
    return True if only_slow and b"slow" not in collection_path.read_bytes() else None


TOGETHER = ("tests/plugins/edit3r_diffusers/", "tests/plugins/edit3r_training/")
"""Rooms that one process does alone: what they import takes seconds in each that does."""


def _room(nodeid):
    return next((room for room in TOGETHER if nodeid.startswith(room)), "")


def pytest_collection_modifyitems(items):
    """Rooms that one process does alone come first, so that the others fill up the time."""
    items.sort(key=lambda item: not _room(item.nodeid))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    from xdist.scheduler import LoadFileScheduling

    class ByRoomOrFile(LoadFileScheduling):
        def _split_scope(self, nodeid):
            return _room(nodeid) or super()._split_scope(nodeid)

    if config.getvalue("dist") == "loadfile":
        return ByRoomOrFile(config, log)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Hold quick tests to `--quick-limit`.

    What is imported for the first time is not the test's doing.
    """
    limit = item.config.getoption("--quick-limit")
    modules, before = len(sys.modules), _cpu_seconds()
    answer = yield
    if limit is None or item.get_closest_marker("slow"):
        return answer
    spent = _cpu_seconds() - before
    if spent > limit and len(sys.modules) < modules + MANY_IMPORTS:
        pytest.fail(
            f"took {spent:.1f} CPU seconds, {limit:g} at most: make it quicker or mark it slow."
        )
    return answer


def _cpu_seconds():
    """CPU seconds of this process and of its children that have ended."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system
