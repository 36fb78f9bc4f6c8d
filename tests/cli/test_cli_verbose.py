"""-v, completion in shells, and what the bare command prints."""

from __future__ import annotations

import logging
import shutil
import subprocess
import sys

import pytest

from clvol.cli.group import COMMANDS

SMALL = ("render", "scene.toml", "-o", "a.png")


def lines(outcome, name: str) -> list[str]:
    head = f"clvol: {name}: "
    return [line.removeprefix(head) for line in outcome.err.splitlines() if line.startswith(head)]


def test_no_command_prints_the_help(run):
    outcome = run()
    assert (outcome.status, outcome.err) == (0, "")
    assert outcome.out == run("--help").out and "CLVOL_DEBUG=1" in outcome.out


@pytest.mark.parametrize("words", [("-v", *SMALL), (*SMALL, "-v"), ("--verbose", *SMALL, "-v")])
def test_verbose_logs_decisions_to_stderr_alone(run, folder, words):
    quiet, loud = run(*SMALL), run(*words)
    assert (quiet.err, quiet.out, quiet.status) == ("", loud.out, loud.status) and quiet.status == 0
    assert len(lines(loud, "scene")) >= 3 and "method raycast" in lines(loud, "scene")[1]
    assert lines(loud, "opencl.context")[0].startswith("rendering on ")
    built = lines(loud, "opencl.build")
    assert any(line.startswith("raycast.cl: ") and "-DLANES" in line for line in built)
    assert lines(loud, "transfer.pieces") and lines(loud, "schedule.tiles")
    assert all(line.startswith("clvol: ") for line in loud.err.splitlines())
    assert run(*SMALL).err == ""  # the log has ended


def test_verbose_logs_the_settings_that_an_error_target_tries(run, folder):
    tried = lines(run(*SMALL, "-v", "--max-error", "0.01"), "accuracy.trials")
    assert len(tried) > 1 and all(line.startswith("tried ") for line in tried)


def test_the_second_process_finds_programs_in_the_cache(folder):
    words = [sys.executable, "-m", "clvol", *SMALL, "-v", "--quiet"]
    for _ in range(2):
        done = subprocess.run(words, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
    built = [line for line in done.stderr.splitlines() if line.startswith("clvol: opencl.build: ")]
    assert built and not any("compiled" in line for line in built)


def test_names_in_the_log_are_harmless(run, folder):
    logger = logging.getLogger("clvol.test")
    outcome = run("-v", "--version")
    assert outcome.status == 0 and not logger.isEnabledFor(logging.INFO)
    from clvol.cli.verbose import _Lines

    record = logging.LogRecord("clvol.test", logging.INFO, "", 0, "\x1b[2Ja\nb", (), None)
    _Lines().emit(record)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_scripts(run, shell):
    outcome = run("completion", shell)
    assert (outcome.status, outcome.err) == (0, "")
    assert f"_CLVOL_COMPLETE={shell}_complete" in outcome.out


def completed(run, monkeypatch, words: str) -> list[str]:
    monkeypatch.setenv("_CLVOL_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split(" ")) - 1))
    outcome = run()
    assert outcome.err == ""
    return [line.partition(",")[2] for line in outcome.out.splitlines()]


def test_commands_options_keys_and_files_are_completed(run, monkeypatch, folder):
    assert completed(run, monkeypatch, "clvol ") == list(COMMANDS)
    assert "--max-error" in completed(run, monkeypatch, "clvol render --")
    assert "integration.step=" in completed(run, monkeypatch, "clvol render x --set integ")
    assert "light.0.type=" in completed(run, monkeypatch, "clvol render x --set light")
    assert completed(run, monkeypatch, "clvol scene --keys pyr") == ["pyramid"]
    assert completed(run, monkeypatch, "clvol sheet x --view left") == ["left"]
    assert completed(run, monkeypatch, "clvol sheet x --preset mr-") == ["mr-angiography", "mr-brain"]
    assert completed(run, monkeypatch, "clvol develop x --tone-curve f") == ["filmic"]
    assert completed(run, monkeypatch, "clvol develop x --set overlay.sc") == ["overlay.scale_bar="]
    assert completed(run, monkeypatch, "clvol render sc") == ["sc"]  # the shell completes files


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_takes_the_script(run):
    script = run("completion", "bash").out
    done = subprocess.run(["bash", "-c", script + "\ncomplete -p clvol"], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0 and "_clvol_completion" in done.stdout
