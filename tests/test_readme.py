"""README says what is true: its first command, its example, its test command and its links."""

import importlib
import re
import shlex
import tomllib
from pathlib import Path

import jax
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


def run_examples(capsys, shorter):
    """What README's Python prints, and its names."""
    code, names = "\n".join(fences("python")), {}
    for words, fewer in shorter.items():
        code = re.sub(words, fewer, code)
    exec(compile(code, "README.md", "exec"), names)
    return capsys.readouterr().out, names


def test_the_example_runs_and_is_the_ready_mechanism(capsys):
    printed, names = run_examples(capsys, SHORTER)
    assert "reached its end" in printed and "mean force" in printed
    ready = jc.scenes.slider_crank()
    assert jax.tree.structure(names["rig"]) == jax.tree.structure(ready)
    assert jax.tree.leaves(names["rig"]) == jax.tree.leaves(ready)


@pytest.mark.slow
def test_readme_gives_the_numbers_that_its_example_prints(capsys):
    printed, _ = run_examples(capsys, {})
    numbers = re.findall(r"\(?-?[\d.]+ ± [\d.]+\)?(?:e-?\d+)?", TEXT.split("means a normal")[1])
    assert len(numbers) == 3 and all(number in printed for number in numbers)


def test_readme_and_the_first_studies_of_the_book_state_one_problem():
    """Three pages gave three derivatives of "the slider-crank"."""
    study = re.compile(r"jc\.Problem\((.*?)\nsample = jc\.monte_carlo\(.*?\)", re.S)
    book = ROOT / "notebooks"
    texts = [TEXT, *((book / f"{page}.md").read_text() for page in ("slider_crank", "derivatives"))]
    stated = [study.search(text)[0] for text in texts]
    # The reference path has a name of its own on one page.
    plain = [re.sub(r'ideal\.body\("slider"\)\.com', "path", text) for text in stated]
    assert len({re.sub(r",(?=[)}])", "", re.sub(r"\s+", "", text)) for text in plain}) == 1


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
