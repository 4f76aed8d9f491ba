"""What commands print: JSON for programs, tables for people, nothing when told to be quiet."""

import argparse
import io
import json
import time

import numpy as np
import pytest
from rich.console import Console

from cdm_pin import console


def arguments(**given):
    return argparse.Namespace(**{"quiet": False, "json": False, **given})


def test_json_is_strict_and_holds_arrays(capsys):
    """What --json prints parses as strict JSON: arrays become lists, NaN becomes null, tables are left out."""
    console.emit(arguments(json=True), {"a": np.array([1.0, np.nan]), "b": np.int64(3), "c": (True,)}, "table")
    text = capsys.readouterr().out
    assert json.loads(text, parse_constant=pytest.fail) == {"a": [1.0, None], "b": 3, "c": [True]}


def test_quiet_prints_nothing_but_json_still_does(capsys):
    """--quiet silences results and notices; asked for together, --json wins."""
    console.emit(arguments(quiet=True), {}, "result")
    console.notice(arguments(quiet=True), "notice")
    assert capsys.readouterr() == ("", "")
    console.emit(arguments(quiet=True, json=True), {"x": 1})
    assert json.loads(capsys.readouterr().out) == {"x": 1}


def test_notices_stay_off_standard_output(capsys):
    """Notices go to standard error, so that results can be piped."""
    console.notice(arguments(), "links[2] was heavier")
    out, err = capsys.readouterr()
    assert out == "" and "links[2] was heavier" in err


def test_tables_print_brackets_and_numbers_as_they_are(capsys):
    """Cells are not read as markup, numbers get four digits, nothing is shown as a dash."""
    console.emit(
        arguments(), None, console.table("t", ["key", "value"], [["links[2].mass", 0.123456], ["[red]", None]])
    )
    text = capsys.readouterr().out
    assert "links[2].mass" in text and "[red]" in text and "0.1235" in text and " - " in text


def terminal(monkeypatch):
    stream = io.StringIO()
    monkeypatch.setattr(console, "output", lambda stderr=False: Console(file=stream, force_terminal=True, width=80))
    return stream


def test_bar_shows_step_on_a_terminal(monkeypatch):
    """On a terminal the bar names the step and its percentage."""
    stream = terminal(monkeypatch)
    with console.progress_bar(arguments(), delay=0.0) as progress:
        progress("screening candidates", 0.5)
        time.sleep(0.3)
    assert "screening candidates" in stream.getvalue() and "50%" in stream.getvalue()


def test_short_work_shows_no_bar(monkeypatch):
    """Work that ends before the delay draws nothing."""
    stream = terminal(monkeypatch)
    with console.progress_bar(arguments(), delay=5.0) as progress:
        progress("short", 1.0)
    assert "short" not in stream.getvalue()


def test_no_color_leaves_no_colour_codes(monkeypatch):
    """With NO_COLOR a notice on a terminal carries no colour."""
    stream = io.StringIO()
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setattr(console, "output", lambda stderr=False: Console(file=stream, force_terminal=True))
    console.notice(arguments(), "plain")
    assert stream.getvalue() == "plain\n"


@pytest.mark.parametrize("flag", ["quiet", "json"])
def test_no_bar_with_quiet_or_json(monkeypatch, flag):
    """--quiet and --json switch the bar off, the callback stays callable."""
    stream = terminal(monkeypatch)
    with console.progress_bar(arguments(**{flag: True}), delay=0.0) as progress:
        progress("x", 2.0)
        time.sleep(0.05)
    assert stream.getvalue() == ""


def test_bar_is_cleared_on_interrupt(monkeypatch):
    """Ctrl-C inside the block ends the bar and passes on."""
    terminal(monkeypatch)
    with pytest.raises(KeyboardInterrupt), console.progress_bar(arguments(), delay=0.0) as progress:
        progress("x", 0.1)
        raise KeyboardInterrupt
