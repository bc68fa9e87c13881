"""README says what is true: its first command, its example, its test command and its links."""

import importlib
import re
import shlex
import tomllib
from pathlib import Path

import pytest

import jaxclear as jc

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text()
# Shorter runs and smaller samples than README's, in its own words.
SHORTER = {r"duration=[\d.]+": "duration=0.01", r"samples=\d+": "samples=16"}


def fences(language):
    """Every block of code in that language."""
    return re.findall(rf"^```{language}\n(.*?)^```", TEXT, flags=re.M | re.S)


@pytest.mark.slow
def test_the_first_command_writes_what_readme_says(tmp_path, monkeypatch, keep_settings):
    words = shlex.split(fences("bash")[0].split("&&")[-1])
    program, out = Path(words[0]).name, words.index("--out")
    assert f"`{words[out + 1]}/`" in TEXT
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    module, function = scripts[program].split(":")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "cache"))
    short = ["--samples", "16", "--duration", "0.02", "--turns", "0.01", "--quiet"]
    monkeypatch.chdir(tmp_path)
    getattr(importlib.import_module(module), function)([*words[1:], *short])
    written = {path.suffix for path in (tmp_path / words[out + 1]).iterdir()}
    assert written == {".png", ".csv"}


@pytest.mark.parametrize("code", fences("python"), ids=lambda code: code.split("\n")[0])
def test_the_example_runs(code, capsys):
    for words, fewer in SHORTER.items():
        code = re.sub(words, fewer, code)
    exec(compile(code, "README.md", "exec"), {})
    printed = capsys.readouterr().out
    assert "reached its end" in printed and "mean force" in printed


def test_ci_runs_the_test_command():
    command = next(block for block in fences("bash") if "pytest" in block)
    script = (ROOT / ".ci" / "run").read_text()
    assert command.split("&&")[-1].strip() in script and '".[test]"' in command


def test_what_readme_points_at_is_there():
    links = re.findall(r"\]\(([^)#:]+)\)", TEXT)
    assert links and not [link for link in links if not (ROOT / link).exists()]
    named = re.findall(r"`jc\.([\w.]+)", TEXT)
    assert named
    for path in named:
        found = jc
        for part in path.split("."):
            found = getattr(found, part)
