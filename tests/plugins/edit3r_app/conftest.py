"""A server of the app and a browser, for the tests that click."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request

import pytest

PATIENCE = 120_000  # [ms]
SHIFTED = """window.shifted = 0;
new PerformanceObserver((list) => {
  for (const one of list.getEntries()) if (!one.hadRecentInput) window.shifted += one.value;
}).observe({type: "layout-shift", buffered: true});"""
SOFTWARE_GL = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


class Server:
    """`edit3r app` in a process of its own."""

    def __init__(self, folder, *more, **environment):
        self.more, self.environment = more, environment
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.folder, self.address = folder, f"http://localhost:{self.port}"
        self.start()

    def start(self):
        call = [
            sys.executable,
            *["-m", "edit3r", "app", "--no-browser", "--size", "96", "--port"],
        ]
        call += [str(self.port), "--jobs", str(self.folder), *self.more]
        plain = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith("PYTEST")
        }
        self.process = subprocess.Popen(
            call,
            cwd=self.folder.parent,
            stdout=subprocess.DEVNULL,
            env=plain | self.environment,
        )
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        for _ in range(3000):
            try:
                opener.open(f"{self.address}/static/app.css").close()
                return
            except urllib.error.HTTPError:  # asks for a token
                return
            except OSError:
                assert self.process.poll() is None, "the server ended"
            time.sleep(0.2)
        raise AssertionError("the server did not begin to answer")

    def kill(self, kind=signal.SIGTERM):
        self.process.send_signal(kind)
        self.process.wait()


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("app")
    # What networks find is asked by their own tests: without them all is here in half the time.
    server = Server(
        folder / "jobs",
        EDIT3R_WEIGHTS=str(folder / "weights"),
        PIP_CONFIG_FILE=os.devnull,
        PIP_INDEX_URL="http://127.0.0.1:9",  # nobody answers there
        PIP_RETRIES="0",
    )
    yield server
    server.kill()


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    pytest.importorskip("uvicorn", reason='needs the app: pip install "edit3r[app]"')
    with playwright.sync_playwright() as driver:
        path = (
            os.environ.get("EDIT3R_CHROMIUM")
            or shutil.which("chromium")
            or shutil.which("google-chrome")
        )
        try:
            browser = driver.chromium.launch(executable_path=path, args=SOFTWARE_GL)
        except playwright.Error as error:
            pytest.skip(f"no browser: {str(error).splitlines()[0]}")
        yield browser
        browser.close()


@pytest.fixture
def tab(browser, server):
    """A new tab that notes every console error and every request to elsewhere."""
    if server.process.poll() is not None:
        server.start()  # a test killed it and failed
    context = browser.new_context(accept_downloads=True)
    context.set_default_timeout(PATIENCE)
    context.add_init_script(SHIFTED)
    problems = []

    def new_tab(size=(1280, 800)):
        page = context.new_page()
        page.set_viewport_size({"width": size[0], "height": size[1]})
        page.on(
            "console",
            lambda line: problems.append(line.text) if line.type == "error" else None,
        )
        page.on("pageerror", lambda error: problems.append(str(error)))
        ours = (server.address, "data:", "blob:")
        page.on(
            "request",
            lambda request: (
                None if request.url.startswith(ours) else problems.append(request.url)
            ),
        )
        return page

    new_tab.problems = problems
    yield new_tab
    context.close()
