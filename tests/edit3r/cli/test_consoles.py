"""No output ends a finished run: any code page, closed streams, readers that go away."""

import io
import json
import os
import subprocess
import sys
import time

import pytest
from rich.console import Console

from edit3r.cli.program import SteadyText
from edit3r.kit.command.console import ProgressLines, StageConsole

SPEAKS = r"""
import sys, edit3r.cli.main as m
from edit3r.kit.command.console import StageConsole, print_json
from edit3r.contract.reporting import Report
def speak(argv):
    text = "\u0444\u043e\u0442\u043e \u2264 \u5199\u771f \udcff"
    with StageConsole() as console:
        for listener in (console, print_json):
            report = Report(on_event=listener)
            with report.stage("st" + text):
                report.emit("warn", text)
                report.emit("progress", text, 1, 2)
    open(argv[0], "w").write("done")
    print(text)
    return 0
m._dispatch = speak
from edit3r.cli.program import program
sys.exit(program())
"""
C_LOCALE = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
CONSOLES = {
    "cp1251": ({"PYTHONIOENCODING": "cp1251"}, ""),
    "cp1252": ({"PYTHONIOENCODING": "cp1252"}, ""),
    "cp437": ({"PYTHONIOENCODING": "cp437"}, ""),
    "ascii": ({"PYTHONIOENCODING": "ascii:strict"}, ""),
    "utf-8": ({"PYTHONIOENCODING": "utf-8"}, ""),
    "C": (C_LOCALE, ""),
    "no stdout": ({}, ">&-"),
    "no stderr": ({}, "2>&-"),
    "nothing": (C_LOCALE, "<&- >&- 2>&-"),
    "reader gone": ({}, "2> >(true) > >(true)"),
    "full": ({}, "2>/dev/full"),
}


@pytest.mark.skipif(os.name != "posix", reason="streams are closed by bash")
@pytest.mark.parametrize(("more", "streams"), CONSOLES.values(), ids=CONSOLES)
def test_a_run_ends_well_on_any_console(tmp_path, more, streams):
    done = tmp_path / "done"
    script = f'"$0" -c "$1" "$2" {streams}'
    command = ["bash", "-c", script, sys.executable, SPEAKS, str(done)]
    ended = subprocess.run(
        command, env={**os.environ, **more}, capture_output=True, timeout=60
    )
    assert ended.returncode == 0, ended.stderr
    assert done.read_text() == "done" and b"Error" not in ended.stderr
    lines = [line for line in ended.stderr.splitlines() if line.startswith(b"{")]
    assert all(line.isascii() and json.loads(line)["event"] for line in lines)
    if not streams:
        assert len(lines) == 4 and ended.stdout


class Gone(io.RawIOBase):
    def writable(self):
        return True

    def write(self, data):
        raise BrokenPipeError


def test_what_nobody_reads_is_written_without_an_error():
    stream = SteadyText(io.BufferedWriter(Gone()), "utf-8", line_buffering=True)
    assert stream.write("a line\n" * 10_000) == 70_000
    stream.flush()


# Progress where no bar can be drawn


def lines(**more):
    return ProgressLines(Console(file=io.StringIO(), soft_wrap=True), **more)


def test_a_line_says_what_is_done_and_how_long_it_takes_yet(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    said = lines()
    assert said.line() == ""
    said.hear("start", "edit photos", 0, 0)
    assert said.line() == "edit photos: 0 s so far"
    said.hear("progress", "match", 0, 40)
    assert said.line() == "match: 0 of 40"
    now[0] = 30.0
    said.hear("progress", "match", 10, 40)
    assert said.line() == "match: 10 of 40, about 2 min left"
    said.hear("progress", "match", 40, 40)
    assert said.line() == "edit photos: 30 s so far"
    said.hear("end", "edit photos", 0, 0)
    assert said.line() == ""


def test_lines_come_again_and_again_and_stop():
    said = lines(every=0.01)
    said.hear("start", "reconstruct", 0, 0)
    said.start()
    while said.console.file.getvalue().count("reconstruct: 0 s so far") < 2:
        time.sleep(0.01)
    said.stop()
    length = len(said.console.file.getvalue())
    time.sleep(0.05)
    assert len(said.console.file.getvalue()) == length


def test_a_long_line_stays_one_line(capsys):
    StageConsole()("warn", "word " * 60, 0, 0)
    assert capsys.readouterr().err.count("\n") == 1
